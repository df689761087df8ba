"""The evaluations that output between steps takes."""

from cg.construction.methods.commutator_free import MuntheKaas
from cg.construction.methods.interpolant import evaluations_of_nodes, extension_of, inner_nodes
from cg.construction.methods.splitting import Splitting


def extra_evaluations(method):
    """Return the number of evaluations of an interpolant, besides those at both ends."""
    if isinstance(method, MuntheKaas):
        return len(extension_of(method).theta)
    return evaluations_of_nodes(inner_nodes(method), 2 if isinstance(method, Splitting) else 1)

"""The evaluations that output between steps takes."""

from cg.construction.methods.commutator_free import MuntheKaas
from cg.construction.methods.interpolant import _evaluations, _extension_of, _inner_nodes
from cg.construction.methods.splitting import Splitting


def extra_evaluations(method):
    """Return the number of evaluations of an interpolant, besides those at both ends."""
    if isinstance(method, MuntheKaas):
        return len(_extension_of(method)[1])
    return _evaluations(_inner_nodes(method), 2 if isinstance(method, Splitting) else 1)

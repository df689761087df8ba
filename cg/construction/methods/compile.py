"""Compiles a method into its table, which is all that integrations read of it."""

from __future__ import annotations

from functools import partial

import numpy as np

from cg.construction.conditions import MAX_ORDER, residuals
from cg.construction.methods.commutator_free import MuntheKaas
from cg.construction.methods.interpolant import scheme_of
from cg.construction.methods.magnus import MagnusMethod
from cg.construction.methods.method import Method
from cg.construction.methods.paths import MethodPaths, error_power, paths_of, polynomial_paths
from cg.construction.methods.splitting import Splitting
from cg.tables.table import Kind, MethodTable

_MIN_DIFFERENCE = 1e-6  # least difference of elementary weights of two results that make a pair


def compiled(method: Method) -> MethodTable:
    """Return the table of a method, which `Method.table` keeps."""
    exponent = 0.0 if method.embedded_order is None else error_exponent(method)
    one_flow = None
    if isinstance(method, MagnusMethod) and (polynomial := polynomial_paths(method)):
        one_flow = table_of_paths(method, polynomial, 1.0 / (method.stages + polynomial.power))
    return table_of_paths(method, paths_of(method), exponent, one_flow)


def table_of_paths(
    method: Method, paths: MethodPaths, exponent: float, polynomial: MethodTable | None = None
) -> MethodTable:
    """Return the table of a method whose steps follow paths."""
    vectors = len(paths.stages) + len(paths.brackets)
    pair = method.embedded_order is not None
    return MethodTable(
        name=method.name, kind=kind_of(method), label=repr(method), order=method.order,
        embedded_order=method.embedded_order, stages=method.stages, exponent=exponent,
        kept_vectors=vectors if paths.registers is None else 1,
        kept_nodes=vectors * (method.explicit and method.stages > 2 and not any(paths.stages)),
        converges=method.satisfies(1), estimate_fault=_estimate_fault(method) if pair else "",
        numbers=paths.numbers, arrays=paths.arrays, output=scheme_of(method, paths),
        polynomial=polynomial, method=method,
    )  # fmt: skip


def _estimate_fault(method: Method) -> str:
    """Return the reason why the error estimate of a pair is unreliable, or an empty text."""
    order, second = method.order, method.embedded_order
    assert second is not None
    trees = min(order, second) + 1
    if trees <= MAX_ORDER and not isinstance(method, MagnusMethod):
        compute = method.residuals if isinstance(method, MuntheKaas) else partial(residuals, method)
        results = [np.array(compute(trees, embedded=second), float) for second in (False, True)]
        if np.abs(np.subtract(*results)).max() < _MIN_DIFFERENCE:
            return "its results nearly coincide, so that the error estimate is next to nothing"
    if second == 0:
        return "its second result has order 0, so that the error estimate stays large"
    if second == order:
        return f"both its results have order {order}, so that the error estimate may miss the error"
    third = method.third_order
    if third is not None and 1.0 / error_exponent(method) > max(order, second) + 1:
        return (
            f"its third result has order {third}, so that the error estimate decreases faster than "
            "the error in short steps"
        )
    return ""


def kind_of(method: Method) -> Kind:
    """Return how a method takes a step."""
    if isinstance(method, Splitting):
        return Kind.SPLITTING
    if isinstance(method, MagnusMethod):
        return Kind.LINEAR
    if isinstance(method, MuntheKaas):
        return Kind.ALGEBRA if method.explicit else Kind.COLLOCATION
    return Kind.GROUP if method.explicit else Kind.IMPLICIT


def error_exponent(method: Method) -> float:
    """Return the power of an error that a step is proportional to, by the orders of a pair."""
    if (third := method.third_order) is not None:
        pair = method.advancing_method if isinstance(method, MuntheKaas) else method
        second = min(pair.order, pair.embedded_order or 0)  # the first one may be lower
        return 1.0 / max(second + 1 + error_power(pair) * (second - third), 1)
    orders = method.order, method.embedded_order
    return 1.0 / (min(order for order in orders if order is not None) + 1)

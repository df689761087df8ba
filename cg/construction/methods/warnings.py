"""Reasons why the error estimate of a pair is unreliable."""

from functools import partial

import numpy as np

from cg.construction.conditions import MAX_ORDER, residuals
from cg.construction.methods.magnus import MagnusMethod
from cg.construction.methods.method import Method
from cg.construction.methods.munthe_kaas import MuntheKaas

MIN_DIFFERENCE = 1e-6
"""Smallest useful difference of elementary weights of both results of a pair."""


def estimate_fault(method: Method) -> str:
    """Return the reason why the error estimate of a pair is unreliable, or an empty text."""
    order, second = method.order, method.embedded_order
    assert second is not None
    trees = min(order, second) + 1
    if trees <= MAX_ORDER and not isinstance(method, MagnusMethod):
        compute = method.residuals if isinstance(method, MuntheKaas) else partial(residuals, method)
        results = [np.array(compute(trees, embedded=second), float) for second in (False, True)]
        if np.abs(np.subtract(*results)).max() < MIN_DIFFERENCE:
            return "its results nearly coincide, so that the error estimate is next to nothing"
    if second == 0:
        return "its second result has order 0, so that the error estimate stays large"
    if second == order:
        return f"both its results have order {order}, so that the error estimate may miss the error"
    return ""

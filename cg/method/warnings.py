"""Warnings about methods that don't converge and pairs whose error estimates are unreliable."""

import warnings
from functools import partial

import numpy as np

from cg.conditions import MAX_ORDER, residuals
from cg.method.magnus import MagnusMethod
from cg.method.method import Method
from cg.method.munthe_kaas import MuntheKaas
from cg.support.copies import cached

MIN_DIFFERENCE = 1e-6
"""Smallest useful difference of elementary weights of both results of a pair."""


_NO_ORDER = "{} has order 0: its solutions don't converge"


def check_order(method: Method, *, stacklevel: int = 2) -> None:
    """Warn if a method has order 0: the weights of its result don't add up to one."""
    if not _converges(method):
        warnings.warn(_NO_ORDER.format(_name(method)), stacklevel=stacklevel + 1)


def check_pair(method: Method, *, stacklevel: int = 2) -> None:
    """Warn if the orders of a pair are equal, one is 0, or its results nearly coincide."""
    if method.embedded_order is None:
        raise ValueError(f"method must be a pair, got {method!r}")
    for message in _faults(method):
        warnings.warn(message, stacklevel=stacklevel + 1)


@cached
def _converges(method: Method) -> bool:
    # to compute a high order takes seconds
    return method.satisfies(1)


@cached
def _faults(method: Method) -> list[str]:
    """Return what is to warn about a pair."""
    texts = [] if _converges(method) else [_NO_ORDER.format(_name(method))]
    fault = _fault(method)
    return [*texts, f"{_name(method)}: {fault}"] if fault else texts


def _fault(method: Method) -> str:
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


def _name(method: Method) -> str:
    return method.name or "the method"

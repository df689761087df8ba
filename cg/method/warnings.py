"""Warnings about methods whose steps, or whose error estimates, are worth little."""

from __future__ import annotations

import warnings

import numpy as np
from numpy.typing import NDArray

from ..conditions import MAX_ORDER, residuals_of
from .magnus import MagnusMethod
from .method import Method, remembered
from .munthe_kaas import MuntheKaas

__all__ = ["check_order", "check_pair"]

MIN_DIFFERENCE = 1e-6
"""Of elementary weights of both results, through the order of the estimate: less says nothing."""


def check_order(method: Method, *, stacklevel: int = 2) -> None:
    """Warn of a method that has order 0.

    Parameters
    ----------
    method : Method
    stacklevel : int, optional
        As for `warnings.warn`, for the caller of this function.

    Warns
    -----
    UserWarning
        If the steps don't converge, since the weights of the result don't add up to one.
    """
    if not _converges(method):
        warnings.warn(
            f"{_name(method)} has order 0: its solutions don't converge", stacklevel=stacklevel + 1
        )


def check_pair(method: Method, *, stacklevel: int = 2) -> None:
    """Warn of a pair whose results don't tell the error of a step.

    Parameters
    ----------
    method : Method
        A pair.
    stacklevel : int, optional
        As for `warnings.warn`, for the caller of this function.

    Warns
    -----
    UserWarning
        If one of the orders is 0, both are the same, or both results nearly coincide.

    Raises
    ------
    ValueError
        If the method is no pair.
    """
    if method.embedded_order is None:
        raise ValueError(f"method must be a pair, got {method!r}")
    check_order(method, stacklevel=stacklevel + 1)
    if message := _fault(method):
        warnings.warn(f"{_name(method)}: {message}", stacklevel=stacklevel + 1)


@remembered
def _converges(method: Method) -> bool:
    # the order itself takes seconds to compute where it is high
    return method.satisfies(1)


@remembered
def _fault(method: Method) -> str:
    """Return what is wrong with a pair, or nothing."""
    order, second = method.order, method.embedded_order
    assert second is not None
    trees = min(order, second) + 1
    if trees <= MAX_ORDER and not isinstance(method, MagnusMethod):
        results = [_residuals(method, trees, embedded) for embedded in (False, True)]
        if np.abs(np.subtract(*results)).max() < MIN_DIFFERENCE:
            return "its results nearly coincide, so that the error estimate is next to nothing"
    if second == 0:
        return "its second result has order 0, so that the error estimate stays large"
    if second == order:
        return f"both its results have order {order}, so that the error estimate may miss the error"
    return ""


def _residuals(method: Method, order: int, embedded: bool) -> NDArray[np.float64]:
    if isinstance(method, MuntheKaas):
        return np.array(method.residuals(order, embedded=embedded), dtype=np.float64)
    return residuals_of(method, order, embedded=embedded)


def _name(method: Method) -> str:
    return method.name or "the method"

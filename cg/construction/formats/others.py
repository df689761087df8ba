"""Conversion of methods to classical tableaux of diffrax and nodepy."""

from fractions import Fraction
from typing import Any

import numpy as np

from cg.construction.catalogue import resolve_method
from cg.construction.methods.method import Method


def to_diffrax(method: str | Method) -> Any:
    """Return the classical tableau of an explicit method as a ``diffrax.ButcherTableau``.

    A pair advances with the weights of higher order. Without second weights the error is zero.
    """
    method = _explicit(method)
    if method.stages == 1:
        raise ValueError(f"method must have two stages or more for diffrax, got {method!r}")
    import diffrax

    b, second = _weights(method)
    error = [x - y for x, y in zip(b, second or b, strict=True)]
    a, _ = method.exact
    return diffrax.ButcherTableau(
        c=method.c[1:],
        b_sol=_array(b),
        b_error=_array(error),
        a_lower=tuple(_array(row[:i]) for i, row in enumerate(a[1:], 1)),
    )


def to_nodepy(method: str | Method) -> Any:
    """Return the classical tableau of an explicit method as one of nodepy.

    It is an ``ExplicitRungeKuttaPair``, weights of higher order first, or not a pair. Coefficients
    are rational numbers of SymPy if all are rational, else doubles.
    """
    method = _explicit(method)
    from nodepy import runge_kutta_method
    from sympy import Rational

    rational = all(coefficient.unit == 0 for coefficient in method.coefficients)

    def array(rows: Any) -> Any:
        numbers = np.array(rows, dtype=object)
        if not rational:
            return numbers.astype(np.float64)
        convert = np.frompyfunc(lambda x: Rational(x.numerator, x.denominator), 1, 1)
        return convert(numbers)

    b, second = _weights(method)
    names = {"name": method.name or "Runge-Kutta Method", "description": method.source}
    a = array(method.exact[0])
    if second is None:
        return runge_kutta_method.ExplicitRungeKuttaMethod(a, array(b), **names)
    return runge_kutta_method.ExplicitRungeKuttaPair(a, array(b), array(second), **names)


def _explicit(method: str | Method) -> Method:
    method = resolve_method(method)
    if not method.explicit:
        raise ValueError(f"method must be explicit, got {method!r}")
    return method


def _weights(method: Method) -> tuple[tuple[Fraction, ...], tuple[Fraction, ...] | None]:
    """Return the weights of higher order, and the other weights of a pair."""
    b, second = method.exact[1], method.exact_embedded
    if second is not None and (method.embedded_order or 0) > method.order:
        return second, b
    return b, second


def _array(row: Any) -> np.ndarray[Any, np.dtype[np.float64]]:
    return np.array([float(entry) for entry in row])

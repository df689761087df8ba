"""Numbers of python-flint: conversions, and the precision of balls in the whole process."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from fractions import Fraction
from typing import TYPE_CHECKING

from cg.support import flint
from cg.support.forks import in_children

if TYPE_CHECKING:
    from cg.support.flint import arb, fmpq

_lock = threading.RLock()
_holders: list[tuple[int, int]] = []  # threads and their previous precisions, the outermost first


def _take_over() -> None:
    """Replace the lock in a forked child, in which the thread that holds it doesn't exist."""
    global _lock  # noqa: PLW0603
    if _holders and _holders[0][0] == threading.get_ident():
        return
    _lock = threading.RLock()
    if _holders:
        flint.ctx.prec = _holders[0][1]
        _holders.clear()


in_children(_take_over)


@contextmanager
def working_precision(bits: int) -> Iterator[None]:
    """Set the precision of balls, in bits, for a ``with`` block; other threads that set it wait."""
    ctx = flint.ctx
    with _lock:
        before = ctx.prec
        _holders.append((threading.get_ident(), before))
        try:
            ctx.prec = bits
            yield
        finally:
            ctx.prec = before
            _holders.pop()


def have_flint() -> bool:
    """Return whether python-flint is installed."""
    try:
        import flint as _  # noqa: F401
    except ModuleNotFoundError:
        return False
    return True


def to_flint(value: Fraction | float) -> fmpq:
    """Return a rational of python-flint, many times faster than Fractions with many digits.

    Without python-flint it is a Fraction.
    """
    if not have_flint():
        return Fraction(value)
    return flint.fmpq(*value.as_integer_ratio())


def to_ball(value: Fraction | float | arb) -> arb:
    """Return a ball around a finite number, in the current precision; a ball as it is."""
    return value if isinstance(value, flint.arb) else flint.arb(to_flint(value))


def to_fraction(value: fmpq) -> Fraction:
    """Return a rational of python-flint as a Fraction."""
    return value if isinstance(value, Fraction) else Fraction(int(value.p), int(value.q))


def exact_midpoint(ball: arb) -> Fraction:
    """Return the midpoint of a ball, exactly."""
    mantissa, exponent = ball.mid().man_exp()
    return int(mantissa) * Fraction(2) ** int(exponent)

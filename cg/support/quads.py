"""Numbers with more digits than doubles: IEEE binary128 as bytes, and those of python-flint.

The compiled core passes ``real(16)`` numbers as 16 bytes, since neither NumPy nor C has a
portable type for them. An array of such numbers is an ``int8`` array whose last axis has
length 16, in little-endian byte order.
python-flint has one precision of balls in the whole process.
"""

from __future__ import annotations

import threading
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from decimal import MAX_EMAX, MIN_EMIN, ROUND_HALF_EVEN, Context, Decimal
from fractions import Fraction
from functools import cache
from importlib import import_module
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from cg.support import flint
from cg.support.arrays import Array
from cg.support.checks import check_integer
from cg.support.parallel import in_children
from cg.support.parsing import read_fraction

if TYPE_CHECKING:
    from cg.support.flint import arb, fmpq


Quads = NDArray[np.int8]
"""Array of binary128 numbers, shape (..., 16)."""

DECIMAL_DIGITS = 36
"""Number of significant decimal digits that distinguish all binary128 numbers."""

MAX_WRITTEN = 4000
"""Largest number of digits to write: Python writes integers of up to 4300 digits by default."""

_PRECISION = 113
_MIN_EXPONENT = -16494  # exponent of the last bit of the smallest subnormal
_MAX_EXPONENT = 16383 - 112
_MAX_DIGITS = 100_000
_MAX_PLACES = 100  # Numbers with more decimal places are written with an exponent.


class MissingQuadsError(RuntimeError):
    """Raised if an operation needs quadruple precision, but the build has none.

    Examples
    --------
    >>> import crouch_grossman as cg
    >>> from cg.support import quads
    >>> try:
    ...     core = quads.core("refinement")
    ... except cg.MissingQuadsError:
    ...     print("built with -Dquad=disabled: double precision only")
    """


@cache
def _compiled() -> Any:
    try:
        return import_module("cg._core_r128")
    except ModuleNotFoundError:
        return None


def core(label: str) -> Any:
    """Return the compiled core in real(16), which `label` needs; MissingQuadsError without it."""
    if (compiled := _compiled()) is None:
        raise MissingQuadsError(
            f"{label} needs quadruple precision, which this build of crouch-grossman was made "
            "without (-Dquad=disabled); build it with gfortran to have it"
        )
    return compiled


def encode(values: Iterable[Fraction | int | float | str]) -> Quads:
    """Round exact values, or texts that `fractions.Fraction` reads, to binary128; shape (n, 16)."""
    packed = b"".join(_encode_one(Fraction(value)) for value in values)
    return np.frombuffer(packed, dtype=np.int8).reshape(-1, 16).copy()


def finite_fraction(value: Any, claim: str) -> Fraction:
    """Return a finite real number exactly; the ValueError for others begins with `claim`."""
    try:
        return read_fraction(value.item() if isinstance(value, np.generic) else value)
    except (TypeError, ValueError, OverflowError, ZeroDivisionError):
        raise ValueError(f"{claim} finite real numbers, got {value!r}") from None


def _encode_one(value: Fraction) -> bytes:
    sign = int(value < 0)
    value = abs(value)
    if value == 0:
        return bytes(16)
    exponent = value.numerator.bit_length() - value.denominator.bit_length() - _PRECISION
    exponent = max(exponent, _MIN_EXPONENT)
    significand = round(value / Fraction(2) ** exponent)
    while significand >= 1 << _PRECISION:  # the estimated exponent may be one too small
        exponent += 1
        significand = round(value / Fraction(2) ** exponent)
    if exponent > _MAX_EXPONENT:
        raise OverflowError(f"value {float(value):.3g} is beyond the range of binary128")
    normal = significand >> (_PRECISION - 1)
    biased = exponent - _MIN_EXPONENT + normal if normal else 0
    fraction = significand - (normal << (_PRECISION - 1))
    return (sign << 127 | biased << 112 | fraction).to_bytes(16, "little")


def decode(quads: Quads) -> list[Fraction]:
    """Return the exact values of binary128 numbers, of shape (n, 16)."""
    data = quads.tobytes()
    return [_decode_one(data[i : i + 16]) for i in range(0, len(data), 16)]


def _decode_one(data: bytes) -> Fraction:
    bits = int.from_bytes(data, "little")
    biased = bits >> 112 & 0x7FFF
    fraction = bits & ((1 << 112) - 1)
    if biased == 0x7FFF:
        raise ValueError("a binary128 number is not finite")
    significand = fraction | (1 << 112 if biased else 0)
    exponent = max(biased, 1) - 1 + _MIN_EXPONENT
    magnitude = Fraction(significand) * Fraction(2) ** exponent
    return -magnitude if bits >> 127 else magnitude


def to_float(quads: Quads) -> Array:
    """Round binary128 numbers of shape (..., 16) to doubles of shape (...)."""
    flat = np.ascontiguousarray(quads).reshape(-1, 16)
    values: Array = core("cg.support.quads.to_float").to_double(flat.T)
    return values.reshape(quads.shape[:-1])


def from_float(values: Any) -> Quads:
    """Widen doubles of shape (...) to binary128 numbers of shape (..., 16), exactly."""
    array = np.asarray(values, dtype=np.float64)
    quads: Quads = core("cg.support.quads.from_float").from_double(array.ravel())
    return np.ascontiguousarray(quads.T).reshape(*array.shape, 16)


def to_decimal(value: Fraction, digits: int = DECIMAL_DIGITS, *, zeros: bool = False) -> str:
    """Return an exact value in decimal, rounded to significant digits, at most 100000.

    Trailing zeros are left out unless `zeros` is true. The text is positional, except that
    magnitudes beyond ``10**±100`` are written as in ``"-1.25e-4950"``.
    """
    if not isinstance(value, Fraction | int) or isinstance(value, bool):
        raise TypeError(f"value must be a Fraction, got {value!r}")
    digits = check_integer("digits", digits, 1, _MAX_DIGITS)
    if value == 0:
        return "0"
    context = Context(prec=digits, rounding=ROUND_HALF_EVEN, Emax=MAX_EMAX, Emin=MIN_EMIN)
    number = context.divide(Decimal(value.numerator), Decimal(value.denominator))
    exponent = number.adjusted()
    if zeros:
        number = number.quantize(Decimal((0, (1,), exponent - digits + 1)), context=context)
    else:
        number = number.normalize(context)
    if abs(exponent) > _MAX_PLACES:
        return f"{number.scaleb(-exponent, context):f}e{exponent}"
    return f"{number:f}"


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
    return find_spec("flint") is not None


def to_flint(value: Fraction | float) -> fmpq:
    """Return a rational of python-flint, many times faster than Fractions with many digits.

    Without python-flint it is a Fraction.
    """
    return flint.fmpq(*value.as_integer_ratio()) if have_flint() else Fraction(value)


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

"""Coefficients with their exact value, their text and their uncertainty."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Set
from contextlib import suppress
from dataclasses import dataclass
from decimal import Decimal
from fractions import Fraction
from numbers import Integral, Rational
from typing import Any

import numpy as np

from cg.construction.points import MethodError
from cg.support.checks import check_integer

MIN_ROUNDED_PLACES = 8
"""Number of decimal places from which a decimal counts as rounded; 0.25 is exact."""

# coefficients are refined in binary128, so that no digit beyond it is significant
_QUAD_UNIT = Fraction(1, 2**112)

_DOUBLE_DIGITS = 17  # decimal digits that distinguish all doubles
_PRINTED_UNIT = Fraction(1, 2**52)  # uncertainty of a decimal that may be a printed double

_RATIONAL = re.compile(r"[+-]?\d+(/\d+)?", re.ASCII)
_DECIMAL = re.compile(
    r"[+-]? (?=\.?\d) \d* (\.(?P<fraction>\d*))? ([eE](?P<exponent>[+-]?\d{1,4}))?",
    re.ASCII | re.VERBOSE,
)
_BINARY = re.compile(r"[+-]?0x[01](\.[0-9a-f]*)?p[+-]?\d{1,4}", re.ASCII)


@dataclass(frozen=True)
class Coefficient:
    """A coefficient of a method: a `text`, its exact value, and the unit of its last place.

    The text is an integer, a rational like ``"119/216"``, a decimal with all its digits, or a
    double as ``float.hex`` writes it. `unit` is the largest distance of the intended number from
    `value`. It is 0 for zero, integers, rationals and decimals with fewer than `MIN_ROUNDED_PLACES`
    places, and ``2**-53`` of the magnitude for doubles. Other decimals have one unit in the last
    place, at least ``2**-52`` of the magnitude with up to 17 digits and ``2**-112`` with more.
    """

    value: Fraction
    text: str
    unit: Fraction

    @classmethod
    def read(cls, number: Any) -> Coefficient:
        """Return the coefficient that a finite number or a text stands for, else ValueError."""
        if isinstance(number, Coefficient):
            return number
        if isinstance(number, str | Decimal):
            return cls._from_text(str(number).strip())
        if isinstance(number, (bool, np.bool)):
            raise ValueError(f"expected a finite real number, got {number!r}")
        if isinstance(number, Integral):
            return cls._from_text(str(int(number)))
        if isinstance(number, Rational):
            return cls._from_text(f"{int(number.numerator)}/{int(number.denominator)}")
        if isinstance(number, (float, np.floating)) and math.isfinite(number):
            if float(number) == number:
                return cls._from_text(float(number).hex())
            raise ValueError(f"expected a number no more precise than a double, got {number!r}")
        raise ValueError(f"expected a finite real number, got {number!r}")

    @classmethod
    def _from_text(cls, text: str) -> Coefficient:
        if _RATIONAL.fullmatch(text):
            numerator, _, denominator = text.partition("/")
            if denominator and int(denominator) == 0:
                raise ValueError(f"expected a finite real number, got {text!r}")
            value = Fraction(int(numerator), int(denominator or 1))
            return cls(value, str(value), Fraction(0))
        if match := _DECIMAL.fullmatch(text):
            value = Fraction(text)
            if value == 0:
                return cls(value, "0", Fraction(0))
            places = len(match["fraction"] or "") - int(match["exponent"] or 0)
            if places < MIN_ROUNDED_PLACES:
                return cls(value, text, Fraction(0))
            digits = len(str(abs(int(value * Fraction(10) ** places))))
            relative = _PRINTED_UNIT if digits <= _DOUBLE_DIGITS else _QUAD_UNIT
            return cls(value, text, max(Fraction(1, 10**places), abs(value) * relative))
        if _BINARY.fullmatch(text):
            double = float.fromhex(text)
            if double == 0:
                return cls(Fraction(0), "0", Fraction(0))
            return cls(Fraction(double), double.hex(), abs(Fraction(double)) / 2**53)
        raise ValueError(f"expected a finite real number, got {text!r}")


def read_coefficient(number: Any, label: str) -> Coefficient:
    """Return a coefficient; MethodError unless it is in the range of doubles."""
    try:
        coefficient = Coefficient.read(number)
        float(coefficient.value)
    except ValueError as problem:
        raise MethodError(f"{label}: {problem}") from None
    except OverflowError:
        raise MethodError(f"{label}: {number} is beyond the range of doubles") from None
    return coefficient


def read_sequence(value: Any, label: str, *, of: str = " of numbers") -> list[Any]:
    """Return a sequence as a list; MethodError for texts, sets, mappings and single values."""
    # sets have no order, and iterating over a mapping gives its keys
    if not isinstance(value, str | bytes | Set | Mapping):
        with suppress(TypeError):
            return list(value)
    raise MethodError(f"{label} must be a sequence{of}, got {value!r}")


def read_row(
    row: Any, label: str, count: int | None = None, entry: str = ""
) -> tuple[Coefficient, ...]:
    """Return the coefficients of a row, `count` of them, or at least one if `count` is None.

    Errors name coefficients by `entry`, which has the number from 1, or as ``label[k]`` from 0.
    """
    numbers = read_sequence(row, label)
    if count is None and not numbers:
        raise MethodError(f"{label} must have at least one entry, got none")
    if count is not None and len(numbers) != count:
        raise MethodError(f"{label} must have {count} entries, got {len(numbers)}")
    names = (entry.format(k + 1) if entry else f"{label}[{k}]" for k in range(len(numbers)))
    return tuple(map(read_coefficient, numbers, names))


def values_of(rows: Any, kind: str = "value") -> Any:
    """Return nested tuples of coefficients, or None, with their values or their units."""
    if isinstance(rows, Coefficient):
        return getattr(rows, kind)
    return rows and tuple(values_of(row, kind) for row in rows)


def read_third(third: Any, stages: int, second: object) -> tuple[Coefficient, ...] | None:
    """Return third weights, one for each stage, or None; MethodError if `second` is None."""
    if third is None:
        return None
    if second is None:
        raise MethodError("third must be None unless there is a second result")
    return read_row(third, "third", stages)


def read_texts(
    name: Any, source: Any, nominal_order: Any = None, nominal_residual: Any = None
) -> dict[str, Any]:
    """Return the fields that all methods have, checked."""
    for label, text in (("name", name), ("source", source)):
        if not isinstance(text, str):
            raise MethodError(f"{label} must be a str, got {text!r}")
        if any("\ud800" <= letter <= "\udfff" for letter in text):
            raise MethodError(f"{label} must be text, got {text!r}, which no encoding can hold")
    if (nominal_order is None) != (nominal_residual is None):
        raise MethodError("nominal_order and nominal_residual must be given together")
    if nominal_order is not None:
        try:
            nominal_order = check_integer("nominal_order", nominal_order, 1)
        except (TypeError, ValueError) as problem:
            raise MethodError(str(problem)) from None
        nominal_residual = read_coefficient(nominal_residual, "nominal_residual")
    nominal = {"nominal_order": nominal_order, "nominal_residual": nominal_residual}
    return {"name": name, "source": source} | nominal

"""Exact numbers ``a + b √d`` with rational a and b, and linear algebra with them."""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction
from math import isqrt
from typing import Any

from flint import arb, fmpq, fmpz_mat

from ...support.balls import to_flint, to_fraction

_DIGITS = 33  # of decimals that are recognised


class Quadratic:
    """A number ``a + b √d``; rational for d = 0.

    d is no square, and the same one throughout a computation.
    """

    __slots__ = ("a", "b", "d")

    def __init__(self, a: Any, b: Any = 0, d: int = 0) -> None:
        self.a, self.b, self.d = fmpq(a), fmpq(b), d

    @classmethod
    def near(cls, x: Fraction, d: int) -> Quadratic:
        """Return the number with small numerators that is closest to a decimal.

        This is a guess, so results that use it must be checked.
        """
        if d == 0:
            return cls(to_flint(x))
        scale = 10**_DIGITS
        known = [x.numerator * scale // x.denominator, scale, isqrt(d * scale * scale)]
        rows = [[int(i == j) for j in range(3)] + [known[i]] for i in range(3)]
        q, a, b = (int(entry) for entry in fmpz_mat(rows).lll().tolist()[0][:3])
        return cls(fmpq(-a, q), fmpq(-b, q), d) if q else cls(0, 0, d)

    def __add__(self, other: Quadratic) -> Quadratic:
        return Quadratic(self.a + other.a, self.b + other.b, self.d or other.d)

    def __sub__(self, other: Quadratic) -> Quadratic:
        return Quadratic(self.a - other.a, self.b - other.b, self.d or other.d)

    def __mul__(self, other: Quadratic) -> Quadratic:
        d = self.d or other.d
        real = self.a * other.a + d * self.b * other.b
        return Quadratic(real, self.a * other.b + self.b * other.a, d)

    def times(self, factor: int | Fraction) -> Quadratic:
        """Return a rational multiple."""
        share = to_flint(factor)
        return Quadratic(self.a * share, self.b * share, self.d)

    def inverse(self) -> Quadratic:
        """Return the reciprocal; ZeroDivisionError for zero."""
        norm = self.a * self.a - self.d * self.b * self.b
        return Quadratic(self.a / norm, -self.b / norm, self.d)

    def __bool__(self) -> bool:
        return self.a != 0 or self.b != 0

    @property
    def number(self) -> Fraction | arb:
        """The number as a Fraction, or if it isn't rational as a ball."""
        if self.b == 0:
            return to_fraction(self.a)
        return arb(self.a) + arb(self.b) * arb(self.d).sqrt()


def dependencies(vectors: Sequence[Sequence[Quadratic]]) -> list[dict[int, Quadratic]]:
    """Return combinations of vectors of one length that are zero.

    There is one for each vector that depends on those before.
    """
    if not vectors or not vectors[0]:
        return [{k: Quadratic(1)} for k in range(len(vectors))]
    rows = [list(row) for row in zip(*vectors, strict=True)]
    pivots: list[int] = []
    for column in range(len(vectors)):
        rank = len(pivots)
        place = next((i for i in range(rank, len(rows)) if rows[i][column]), None)
        if place is None:
            continue
        inverse = rows[place][column].inverse()
        first = [x * inverse if x else x for x in rows[place]]
        rows[place], rows[rank] = rows[rank], first
        for i, row in enumerate(rows):
            factor = row[column]
            if i != rank and factor:
                rows[i] = [x - factor * y if y else x for x, y in zip(row, first, strict=True)]
        pivots.append(column)
    one = Quadratic(1, 0, vectors[0][0].d)
    return [
        {k: one, **{p: row[k].times(-1) for p, row in zip(pivots, rows, strict=False) if row[k]}}
        for k in range(len(vectors))
        if k not in pivots
    ]

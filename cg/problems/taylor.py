"""Reference solutions of quadratic differential equations, by Taylor series in ball arithmetic.

With the coefficients y_in of unknown i at the start of a step, the terms c y_j y_k of its
derivative give (n + 1) y_i,n+1 = Σ c Σ_m y_jm y_k,n-m. The solutions use no method on manifolds, so
that these can be tested against them.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import numpy as np

from cg.support import flint
from cg.support.arrays import Array
from cg.support.checks import check_integer
from cg.support.parsing import read_fraction
from cg.support.quads import exact_midpoint, to_ball, working_precision

Time = Fraction | float | int | str

_STEP, _ORDER = Fraction(1, 16), 48  # step size and degree of the Taylor polynomials

# (coefficient, indices of at most two unknowns that it multiplies)
Term = tuple[Any, tuple[int, ...]]


@dataclass(frozen=True)
class QuadraticSystem:
    """An initial value problem whose right-hand side is a polynomial of degree at most two.

    `equations` has the terms of the derivative of each unknown. A term ``(c, (i, j))`` is ``c *
    y[i] * y[j]``; with one index or none it is linear or constant. `initial` are the values at time
    zero.
    """

    equations: tuple[tuple[Term, ...], ...]
    initial: tuple[flint.arb, ...]


@dataclass(frozen=True)
class Reference:
    """A solution in extended precision.

    Attributes
    ----------
    times
        The times, exactly.
    values
        For every time the unknowns, as the exact values of extended-precision numbers.
    errors
        For every time an estimate of the largest error of an unknown: the difference of the results
        with two orders and step sizes, including rounding errors.

    Examples
    --------
    >>> from fractions import Fraction
    >>> import crouch_grossman as cg
    >>> reference = cg.problems.StateDependentRotation().reference([Fraction(1, 8)], bits=96)
    >>> reference.y.shape, reference.errors[-1] < 1e-25
    ((1, 10), True)
    >>> float(reference.values[-1][0])
    0.9252992140702843
    """

    times: tuple[Fraction, ...]
    values: tuple[tuple[Fraction, ...], ...]
    errors: tuple[float, ...]

    @property
    def t(self) -> Array:
        """The times rounded to float64, shape ``(n,)``."""
        return np.array([float(t) for t in self.times])

    @property
    def y(self) -> Array:
        """The unknowns rounded to float64, shape ``(n, unknowns)``."""
        return np.array([[float(x) for x in row] for row in self.values])


def reference_solution(
    build: Callable[[], QuadraticSystem], times: Sequence[Time], *, bits: int = 256
) -> Reference:
    """Solve a quadratic system by Taylor series with a fixed step, at times as `exact_times` takes.

    `build` returns the system; it is called with the working precision `bits`. The returned
    solution is a second one with two thirds of the step size and a degree higher by a fifth; the
    difference of both gives the error estimate. ValueError if a time isn't a finite number, or
    ``bits`` is less than 2.
    """
    exact = exact_times(times)
    bits = check_integer("bits", bits, 2)
    with working_precision(bits):
        system = build()
        coarse = solve_at(system, exact, _STEP, _ORDER)
        fine = solve_at(system, exact, _STEP * Fraction(2, 3), _ORDER + _ORDER // 5)
        bounds = [
            max(float((x - y).abs_upper()) for x, y in zip(*rows, strict=True))
            for rows in zip(coarse, fine, strict=True)
        ]
        errors = tuple(math.nextafter(bound, math.inf) for bound in bounds)  # rounded up
        values = tuple(tuple(map(exact_midpoint, row)) for row in fine)
    return Reference(exact, values, errors)


def exact_times(times: Sequence[Time]) -> tuple[Fraction, ...]:
    """Return times exactly, texts as decimals or quotients; ValueError unless they are finite."""
    try:
        return tuple(map(read_fraction, times))
    except (ValueError, OverflowError, TypeError, ZeroDivisionError) as error:
        raise ValueError(f"times must be finite numbers, got {times!r}") from error


def solve_at(
    system: QuadraticSystem, times: tuple[Fraction, ...], step: Fraction, order: int
) -> list[list[flint.arb]]:
    """Return the solution at times, by Taylor series of an order in steps."""
    solutions: dict[Fraction, list[flint.arb]] = {}
    for direction in (1, -1):
        remaining = {t for t in times if t * direction >= 0} - solutions.keys()
        start, point = Fraction(0), list(system.initial)
        series = None
        for t in sorted(remaining, key=abs):
            while abs(t - start) > step:
                series = series or _taylor(system, point, order)
                # Continue with midpoints: the radii would grow much faster than the errors.
                point = [polynomial(to_ball(step * direction)).mid() for polynomial in series]
                start += step * direction
                series = None
            series = series or _taylor(system, point, order)
            solutions[t] = [polynomial(to_ball(t - start)) for polynomial in series]
    return [solutions[t] for t in times]


def _taylor(system: QuadraticSystem, point: list[flint.arb], order: int) -> list[flint.arb_poly]:
    """Return the Taylor polynomials of every unknown."""
    series = [[x] for x in point]
    products = {indices for terms in system.equations for _, indices in terms}
    for n in range(order):
        values = {indices: _coefficient(series, indices, n) for indices in products}
        following = [
            sum((c * values[indices] for c, indices in terms), flint.arb()) / (n + 1)
            for terms in system.equations
        ]
        for coefficients, value in zip(series, following, strict=True):
            coefficients.append(value)
    return [*map(flint.arb_poly, series)]


def _coefficient(series: list[list[flint.arb]], indices: tuple[int, ...], n: int) -> flint.arb:
    """Return the n-th Taylor coefficient of a product of unknowns, by Cauchy's formula for two."""
    if len(indices) < 2:
        return series[indices[0]][n] if indices else flint.arb(int(n == 0))
    first, second = (series[i] for i in indices)
    return sum((x * y for x, y in zip(first, reversed(second), strict=True)), flint.arb())

"""Linear stability, against closed forms and against steps that are taken."""

import math
from fractions import Fraction

import numpy as np
import pytest

import cg
from cg.stability import stability_function, stability_limits


def classical(order):
    """Return the tableau of Taylor's polynomial up to order four."""
    rows = [[], ["1/2"], [0, "1/2"], [0, 0, 1]]
    if order == 4:
        return cg.Tableau(rows, ["1/6", "1/3", "1/3", "1/6"])
    return cg.methods[{1: "LieEuler", 2: "CG2", 3: "CG3"}[order]]


@pytest.mark.parametrize(
    ("order", "real", "imaginary"),
    [(1, 2, 0), (2, 2, 0), (3, 2.5127453266, math.sqrt(3)), (4, 2.7852935634, math.sqrt(8))],
)
def test_taylor_polynomials(order, real, imaginary):
    numerator, denominator = stability_function(classical(order))
    assert numerator == tuple(Fraction(1, math.factorial(k)) for k in range(order + 1))
    assert denominator == (1,)
    limits = stability_limits(classical(order))
    assert limits.real == pytest.approx(real, abs=1e-9)
    assert limits.imaginary == pytest.approx(imaginary, abs=1e-9)


def test_implicit_methods():
    midpoint = stability_limits(cg.methods["ImplicitMidpoint"])
    assert (midpoint.real, midpoint.imaginary) == (math.inf, math.inf)
    numerator, denominator = stability_function(cg.methods["ImplicitMidpoint"])
    assert (numerator, denominator) == ((1, Fraction(1, 2)), (1, Fraction(-1, 2)))


@pytest.mark.parametrize("name", ["CG4a", "CG5a", "CF5a", "DP5(4)", "CF3b"])
def test_limits_are_where_steps_begin_to_grow(name):
    method = cg.methods[name]
    limits = stability_limits(method)

    def factor(z):
        stages = []
        for row in method.a:
            stages.append(z * (1 + sum(a * k for a, k in zip(row, stages, strict=False))))
        return abs(1 + method.b @ np.array(stages))

    inside = np.linspace(0, 0.999 * limits.real, 200)
    assert max(factor(-x) for x in inside) <= 1 + 1e-12
    assert factor(-1.001 * limits.real) > 1
    if limits.imaginary > 0:
        inside = np.linspace(0, 0.999 * limits.imaginary, 200)
        assert max(factor(1j * y) for y in inside) <= 1 + 1e-12
    assert factor(1j * (1.001 * limits.imaginary + 0.2)) > 1

"""Linear stability against closed forms and computed steps."""

import math
from fractions import Fraction
from itertools import pairwise

import numpy as np
import pytest
from coefficients import CLASSICAL
from flint import fmpq_poly, fmpz_poly
from kinds import FROZEN

import cg
from cg.construction.methods.stability import stability_function, stability_limits
from cg.support.quads import to_flint, to_fraction

METHODS = [*map(cg.methods.get, ("LieEuler", "CG2", "CG3")), CLASSICAL]


@pytest.mark.parametrize(("order", "real", "imaginary"), [
    (1, 2, 0), (2, 2, 0), (3, 2.5127453266, math.sqrt(3)), (4, 2.7852935634, math.sqrt(8))
])  # fmt: skip
def test_taylor_polynomials(order, real, imaginary):
    numerator, denominator = stability_function(METHODS[order - 1])
    assert numerator == tuple(Fraction(1, math.factorial(k)) for k in range(order + 1))
    assert denominator == (1,)
    limits = stability_limits(METHODS[order - 1])
    assert limits.real == pytest.approx(real, abs=1e-9)
    assert limits.imaginary == pytest.approx(imaginary, abs=1e-9)


def test_implicit_methods():
    midpoint = stability_limits(cg.methods["ImplicitMidpoint"])
    assert (midpoint.real, midpoint.imaginary) == (math.inf, math.inf)
    numerator, denominator = stability_function(cg.methods["ImplicitMidpoint"])
    assert (numerator, denominator) == ((1, Fraction(1, 2)), (1, Fraction(-1, 2)))


@pytest.mark.parametrize("tiny", ["1e-308", "1e-320", "1e-9999"])
def test_zeros_beyond_doubles(tiny):
    """Those of |R| - 1 with R = 1 + z + tiny z², the last of them about -1 / tiny."""
    assert stability_limits(cg.Tableau([[], [tiny]], [0, 1])).real == 2


SHORT = [name for name, m in FROZEN.items() if m.explicit and m.stages <= 17 and m.order < 7]


@pytest.mark.parametrize("name", [*SHORT, "CG7b"])
def test_steps_grow_beyond_the_limits(name):
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
        assert limits.imaginary > 0.1
        inside = np.linspace(0, 0.999 * limits.imaginary, 200)
        residual = method.nominal_residual
        allowed = 1e-12 if residual is None else float(residual.value)
        assert max(factor(1j * y) for y in inside) <= 1 + allowed
    assert factor(1j * (1.001 * limits.imaginary + 0.2)) > 1


def chain(polynomial):
    """Return a method with a given stability function, whose stages follow each other."""
    ratios = [later / c for c, later in pairwise(polynomial)]
    rows = [[]] + [[0] * i + [ratios[-1 - i]] for i in range(len(ratios) - 1)]
    return cg.Tableau(rows, [0] * (len(ratios) - 1) + [ratios[0]])


def chebyshev(stages, damping):
    """Return the damped polynomial T_s(w0 + w1 z) / T_s(w0) of first order, and its real limit."""
    t, w0 = fmpq_poly(fmpz_poly.chebyshev_t(stages)), to_flint(1 + damping / stages**2)
    w1 = t(w0) / t.derivative()(w0)
    polynomial = t(fmpq_poly([w0, w1])) / t(w0)
    return list(map(to_fraction, polynomial.coeffs())), to_fraction(2 * w0 / w1)


@pytest.mark.parametrize("stages", [2, 5, 9, 10, 25])
@pytest.mark.parametrize("damping", [Fraction(0), Fraction(1, 20), Fraction(2, 13)])
def test_chebyshev_methods(stages, damping):
    """Without damping |R| is one at each inner maximum."""
    polynomial, end = chebyshev(stages, damping)
    method = chain(polynomial)
    assert stability_function(method)[0] == tuple(polynomial)
    limits = stability_limits(method)
    assert limits.real == pytest.approx(float(end), rel=1e-13)
    assert limits.imaginary == 0.0
    if not damping:
        assert end == 2 * stages**2

"""The residuals that rounded coefficients may cause, and whether order conditions hold within them.

The tolerance of a condition is a multiple of the first-order effect of the uncertainties of all
coefficients on its weight. Derivatives and exact residuals are computed only where residuals in
double precision and a cheaper bound of the tolerance don't decide.
"""

from collections.abc import Sequence
from fractions import Fraction

import numpy as np
from numpy.typing import NDArray

from cg.construction import conditions
from cg.construction.layouts import Layout
from cg.construction.methods.coefficients import Coefficient
from cg.construction.points import PointTree
from cg.support.quads import have_flint

Vector = NDArray[np.float64]

TOLERANCE_FACTOR = 2
"""Factor on the first-order effect of rounded coefficients, in the tolerance of residuals."""

_DOUBLE_ROUNDING = 2.0**-40  # safe bound of relative rounding errors of weights in double
_MIN_UNIT = float(np.finfo(np.float64).tiny)
_PROBE = 2.0**-20  # step of the difference quotient in `_bound`


def satisfies(
    tree: PointTree, layout: Layout, coefficients: Sequence[Coefficient], order: int
) -> bool:
    """Return whether the conditions through an order hold, up to the rounding of coefficients."""
    x, units = to_floats(coefficients), _units(coefficients)
    rough = np.abs(conditions.residuals(layout, x, order, independent=True))
    sizes = conditions.weights(layout, np.abs(x), order, independent=True)
    rounding = _DOUBLE_ROUNDING * (1 + sizes)
    if (rough > _bound(layout, x, units, order, sizes) + rounding).any():
        return False  # rejected without derivatives
    allowed = tolerance(layout, coefficients, order)
    if not np.isfinite(allowed).all():
        return False
    if (rough > allowed + rounding).any():
        return False  # rejected without exact arithmetic
    if (allowed > 0).all() and have_flint():
        balls = conditions.residuals(tree, order, independent=True, arithmetic="balls")
        pairs = [(abs(r), float(t)) for r, t in zip(balls, allowed, strict=True)]
        if all(r <= t for r, t in pairs) or any(r > t for r, t in pairs):
            return all(r <= t for r, t in pairs)
    residuals = conditions.residuals(tree, order, independent=True, arithmetic="exact")
    return all(abs(r) <= Fraction(t) for r, t in zip(residuals, allowed, strict=True))


def tolerance(layout: Layout, coefficients: Sequence[Coefficient], order: int) -> Vector:
    """Return the largest residuals, by condition, that rounded coefficients may cause."""
    units = _units(coefficients)
    if not units.any():
        return np.zeros(conditions.count(order, independent=True))
    jacobian = conditions.jacobian(layout, to_floats(coefficients), order, independent=True)
    return np.asarray(TOLERANCE_FACTOR * (np.abs(jacobian) @ units))


def to_floats(coefficients: Sequence[Coefficient]) -> Vector:
    """Return coefficients rounded to double."""
    return np.array([float(coefficient.value) for coefficient in coefficients])


def _units(coefficients: Sequence[Coefficient]) -> Vector:
    # units below the smallest double must not become zero
    units = [coefficient.unit for coefficient in coefficients]
    return np.array([max(float(unit), _MIN_UNIT) if unit else 0.0 for unit in units])


def _bound(layout: Layout, x: Vector, units: Vector, order: int, sizes: Vector) -> Vector:
    """Return an upper bound of `tolerance` that needs no derivatives.

    As functions of the absolute values of the coefficients, weights have nonnegative Taylor
    coefficients. So a forward difference quotient bounds the directional derivative, and this
    bounds the derivative at the coefficients themselves.
    """
    if not units.any():
        return np.zeros_like(sizes)
    probe = np.abs(x) + units * (_PROBE / units.max())
    wide = conditions.weights(layout, probe, order, independent=True)
    # huge coefficients overflow; infinite and NaN bounds decide nothing
    with np.errstate(over="ignore", invalid="ignore"):
        quotient: Vector = (wide - sizes + _DOUBLE_ROUNDING * wide) / _PROBE
        quotient *= 2 * TOLERANCE_FACTOR * units.max()
    return quotient

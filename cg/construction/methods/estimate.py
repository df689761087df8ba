r"""Largest ratio of the error of a step to the error estimate of a pair.

The test problem is a constant generator X with a perturbation, :math:`F(t) = X + ε (t/h)^j V` with
:math:`\operatorname{ad}_X V = iφ V`: the step turns by φ radians. To first order in ε, a result
that follows flows m with weights :math:`α_{mk}` ends at

.. math::

    T_j(φ) = \sum_m e^{-iφ W_m} φ_1(-i w_m φ) \sum_k α_{mk} c_k^j, \qquad
    w_m = \sum_k α_{mk}, \quad W_m = \sum_{n<m} w_n, \quad φ_1(x) = (e^x - 1) / x,

and the solution at :math:`\int_0^1 e^{-iφ s} s^j ds`. A result of a Munthe-Kaas method ends at
:math:`φ_1(-iφ) \sum_i b_i κ_i` with

.. math::

    κ_i = c_i^j D(iφ c_i) - \frac{D(iφ c_i) - 1}{c_i} \sum_k a_{ik} κ_k, \qquad
    D(x) = \sum_n B_n x^n / n! .

Errors at :math:`φ = 0` are those of the quadrature, others also those of commutators. Two results
that share nodes or flows share errors that their difference doesn't see, on any problem. So the
ratio of error to estimate is a property of the coefficients, as the order is.

For Magnus methods X is also multiplied by polynomials of time, g: the weights of a flow then count
times g(c_k), and :math:`∫_0^s g` is the time in the solution. There results differ by the
quadrature of g X, of any size, and by terms in ε that only commutators cause. An estimate that
divides one by the other is blind.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.polynomial.polynomial import polyint, polyval
from numpy.typing import NDArray

from cg.construction.methods.commutator_free import MuntheKaas
from cg.construction.methods.compile import error_exponent
from cg.construction.methods.magnus import MagnusMethod
from cg.construction.methods.method import Method
from cg.construction.methods.paths import paths_of
from cg.construction.methods.reference_step import End, take_paths, with_weights
from cg.frames.algebra import bernoulli_terms
from cg.support.shared_numbers import ERROR_ESTIMATE, EstimateForm

Vector = NDArray[Any]

MAX_RATIO = 10.0
"""Largest ratio of error to estimate of a pair whose estimate can be relied on."""

_MAX_TURN = 6.0  # largest angle of Munthe-Kaas methods: dexp⁻¹ exists below 2π
_MAX_ANGLE = ERROR_ESTIMATE["max_angle"]  # of other methods
_POWERS = range(1, 5)  # powers of time in the perturbation
_STEP = 0.025  # step between angles
_NEARBY = 1.25  # the estimate may vanish at isolated angles, not over this range
_NO_ERROR = 1e-11  # smaller errors of a step are rounding
_CONSTANT = np.array([1.0])
_BASES = _CONSTANT, np.array([0.0, 2.0]), np.array([0.0, 6.0, -6.0]), np.array([3.0, -12.0, 12.0])
"""Polynomials g of time, from the constant upwards, of mean one."""


def estimate_ratio(method: Method) -> float | None:
    """Return the largest ratio of the error of a step to its estimate; None without an estimate.

    The steps turn by up to `_MAX_ANGLE` radians (of Munthe-Kaas methods by less than a turn), with
    perturbations by the powers 1 to 4 of time; further steps integrate powers of time alone, up to
    the order plus 4.
    """
    if method.embedded_order is None:
        return None
    if isinstance(method, MagnusMethod):
        return max(_max_ratio(method, _MAX_ANGLE, base) for base in _BASES)
    if not isinstance(method, MuntheKaas):
        return _max_ratio(method, _MAX_ANGLE)
    series = method.advancing_method.order, None
    return max(_max_ratio(method, _MAX_TURN, powers=powers) for powers in series)


def _max_ratio(
    method: Method, max_angle: float, base: Vector = _CONSTANT, powers: int | None = None
) -> float:
    ratios = [0.0]
    angles = np.arange(_STEP, _NEARBY * max_angle, _STEP)
    first, last = (np.searchsorted(angles, angles * x) for x in (1 / _NEARBY, _NEARBY))
    nodes, weights = np.polynomial.legendre.leggauss(60)
    s = (nodes + 1) / 2
    elapsed = polyval(s, polyint(base))
    c = paths_of(method).abscissae
    for j in _POWERS:
        result, estimate = result_and_estimate(method, c**j, angles, base, powers)
        error = abs(result - np.exp(-1j * np.outer(angles, elapsed)) @ (weights / 2 * s**j))
        for k in np.flatnonzero((error > _NO_ERROR) & (angles <= max_angle)).tolist():
            nearby = estimate[first[k] : last[k] + 1].max()
            ratios.append(error[k] / max(nearby, _NO_ERROR * error[k]))
    for j in range(max(method.order, method.embedded_order or 0) + 5):
        (result,), (quadrature,) = result_and_estimate(method, c**j, np.zeros(1), base, powers)
        off = abs(result - 1 / (j + 1))
        if off > _NO_ERROR:
            ratios.append(off / max(quadrature, _NO_ERROR * off))
    return float(max(ratios))


def result_and_estimate(
    method: Method, values: Vector, angles: Vector, base: Vector = _CONSTANT,
    powers: int | None = None,
) -> tuple[Vector, Vector]:  # fmt: skip
    """Return the result of a step and the estimate of its error, an `EstimateForm`, by angles φ.

    Perturbations have `values` at the nodes; X is multiplied by the polynomial `base` of time.
    The series of dexp⁻¹ has terms up to a power, or all of them. Results are moved back to the
    start of the step, sums of stages are those at its end.
    """
    paths = with_weights(paths_of(method), float)
    lengths, fields = _fields(method, values, angles, base, powers)

    def flow(terms: Sequence[Any], _: Any, point: Any) -> End:
        elapsed, moved = point
        length = sum(weight * lengths[k] for k, weight in terms)
        field = sum(weight * fields[k] for k, weight in terms)
        move = np.exp(-1j * angles * elapsed) * _phi1(-1j * length * angles) * field
        return (elapsed + length, moved + move), None

    ends, _ = take_paths(paths, (0.0, 0j * angles), lambda *_: None, flow, list(fields))
    result, *rest = (ends[k][0][1] for k in (paths.result, paths.embedded, paths.third) if k)
    differences = np.array([result - other for other in rest])
    rows = np.array(paths.errors, np.float64) @ fields if paths.errors else differences
    factor = float(paths.factor)
    if paths.estimate is EstimateForm.AT_END:
        row, *lower = abs(rows)  # a quotient of sums, if there are two
        end = row * row / np.maximum(np.hypot(row, lower[0]), 1e-300) if lower else row
        return result, np.maximum(abs(differences[0]), factor * end)
    if paths.estimate is EstimateForm.PARTS_OF_SERIES:
        commuting = np.array(paths.errors, np.float64) @ values[:, None]
        parts = [commuting + 0 * rows, rows - commuting]
    elif paths.estimate is EstimateForm.PARTS_OF_RESULTS:
        parts = [rows, np.exp(1j * angles) * differences - rows[[0, -1]]]
    elif paths.estimate is EstimateForm.PARTS_OF_SUMS:
        parts = [rows[::2], rows[1::2]]
    else:
        parts = [rows]
    estimates = [_estimate_of_part(abs(part), factor, paths.power) for part in parts]
    if not isinstance(method, MagnusMethod):
        return result, np.max(estimates, axis=0)
    estimate = np.sum(estimates, axis=0)
    if len(parts) > 1:
        # the rest of e2 is O(h³), and with this power of the change of X has the order of the error
        nodal = polyval(paths.abscissae, base)
        change = angles * abs(nodal - nodal[0]).max() / ERROR_ESTIMATE["unit_of_change"]
        power = 1 / error_exponent(method)
        estimate = np.maximum(estimate, abs(parts[1][-1]) * change ** (power - 3))
    return result, estimate


def _estimate_of_part(part: Vector, factor: float, power: int) -> Vector:
    """Return the quotient Q of `EstimateForm` for a part, whose rows are e1, kinks and e2."""
    e1, e2 = (part[:-1].max(axis=0), part[-1]) if len(part) > 1 else (part[0], 0.0)
    quotient = e1 / np.maximum(np.hypot(e1, factor * e2), 1e-300)
    return np.asarray(e1 * quotient**power)


def _fields(
    method: Method, values: Vector, angles: Vector, base: Vector, powers: int | None
) -> tuple[Vector, Vector]:
    """Return the components along X and V of fields at stages and of brackets: (n,), (n, angles).

    The components of a Munthe-Kaas method are the derivatives κ of its coordinates.
    """
    paths, turn = paths_of(method), 1j * angles
    c = paths.abscissae
    if isinstance(method, MuntheKaas):
        scale = (_dexpinv(np.outer(turn, c), powers) - 1) / np.where(c == 0, 1.0, c)
        system = np.eye(len(c)) + scale[..., None] * method.advancing_method.tableau.a
        sources = values * (1 + scale * c)
        return np.ones(len(c)), np.linalg.solve(system, sources[..., None])[..., 0].T
    along_x, along_v = polyval(c, base), np.outer(values, 1 + 0j * angles)
    for pair in paths.brackets:
        u, v = np.array(pair, np.float64)
        bracket = turn * ((u @ along_x) * (v @ along_v) - (v @ along_x) * (u @ along_v))
        along_x, along_v = np.append(along_x, 0.0), np.vstack([along_v, bracket])
    return along_x, along_v


def _phi1(x: Vector) -> Vector:
    small = abs(x) < 1e-5
    safe = np.where(small, 1.0, x)
    return np.where(small, 1 + x / 2, (np.exp(safe) - 1) / safe)


def _dexpinv(x: Vector, powers: int | None) -> Vector:
    if powers is None:
        return np.asarray(1 / _phi1(x))
    return polyval(x, list(map(float, bernoulli_terms(powers))))

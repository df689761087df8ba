"""The spinning top of Section 4, with its reference, for all figures about it."""

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cache
from typing import Literal

import numpy as np

from cg.construction.catalogue import methods
from cg.frames import hat
from cg.integration import integrate
from cg.problems import HeavyTop
from cg.support.arrays import Array

from .quad_steps import end_point

Reading = Literal["momentum", "velocity"]

METHODS = ("CG4", "CG4a", "CG5a", "CG6a")
"""The methods that the paper compares."""

READINGS: dict[Reading, str] = {
    "momentum": "m(0) = ω₀ = (0, 0, 1), as the paper's words have it",
    "velocity": "m(0) = I ω₀ = (0, 0, 1/4), ω₀ an angular velocity",
}
"""Both readings of the paper's ω(0)."""


@dataclass(frozen=True)
class Errors:
    """Errors of one integration in double precision, at every step: arrays of shape (steps + 1,).

    `rotation` and `momentum` are 2-norms of the errors of B and of the momentum, `distance` is the
    distance of B from SO(3) in the 2-norm, after the Newton–Schulz step of each step.
    """

    t: Array
    rotation: Array
    momentum: Array
    distance: Array


@cache
def _reference(reading: Reading, steps: int) -> tuple[Array, tuple[tuple[Fraction, ...], ...]]:
    reference = HeavyTop(reading).reference([Fraction(k, steps) for k in range(steps + 1)])
    return np.array(reference.errors), reference.values


def reference_error(reading: Reading, steps: int) -> float:
    """Return the largest estimated error of the reference on a grid over [0, 1]."""
    return float(_reference(reading, steps)[0].max())


@cache
def reference_end(reading: Reading) -> tuple[tuple[Fraction, ...], float]:
    """Return the exact numbers of the reference at t = 1, and its estimated error."""
    errors, values = _reference(reading, 1)
    return values[-1], float(errors[-1])


@cache
def errors(reading: Reading, method: str, steps: int) -> Errors:
    """Integrate over [0, 1] with equal steps in double precision and compare with the reference."""
    top = HeavyTop(reading)
    solution = integrate(top.f, (0.0, 1.0), top.y0, frame=top.frame, method=method, h=1 / steps)
    values = _reference(reading, steps)[1]
    rotation, momentum = np.transpose(list(map(_norms, solution.y.tolist(), values)))
    off = [off_group(y[:9].tolist()) for y in solution.y]
    return Errors(solution.t, rotation, momentum, np.array(off))


def flow_distances(reading: Reading, method: str, steps: int) -> Array:
    """Return distances of B from SO(3), shape (steps + 1,), where only flow follows flow.

    Steps over [0, 1] are taken here, flow by flow, each by Rodrigues' formula: no quaternions
    between, and no Newton–Schulz step after. The method is an explicit tableau.
    """
    top, tableau, h = HeavyTop(reading), methods[method], 1 / steps

    def follow(y: Array, weights: Sequence[float], fields: Sequence[Array]) -> Array:
        rotation, momentum = y[:9].reshape(3, 3), y[9:]
        for weight, field in zip(weights, fields, strict=False):
            if weight:
                rotation = _rotated(-h * weight * field[:3], rotation.T).T
                momentum = momentum + h * weight * field[3:]
        return np.concatenate([rotation.ravel(), momentum])

    y, points = top.y0, [top.y0]
    for step in range(steps):
        fields: list[Array] = []
        for row, c in zip(tableau.a.tolist(), tableau.c.tolist(), strict=True):
            fields.append(np.array(top.f((step + c) * h, follow(y, row, fields))))
        y = follow(y, tableau.b.tolist(), fields)
        points.append(y)
    return np.array([off_group(point[:9].tolist()) for point in points])


def _rotated(v: Array, columns: Array) -> Array:
    """Return the columns after a rotation, by Rodrigues' formula in half the angle."""
    half = 0.5 * float(np.linalg.norm(v))
    sinc = np.sin(half) / half if half else 1.0
    first = hat(v) @ columns
    return np.asarray(columns + sinc * (np.cos(half) * first + (0.5 * sinc) * (hat(v) @ first)))


def end_error(reading: Reading, method: str, steps: int) -> float:
    """Return the error of B at t = 1 in double precision."""
    top = HeavyTop(reading)
    solution = integrate(
        top.f, (0.0, 1.0), top.y0, frame=top.frame, method=method, h=1 / steps, save_every=steps
    )
    return _norms(solution.y[-1].tolist(), reference_end(reading)[0])[0]


def quad_end_error(reading: Reading, method: str, steps: int) -> float:
    """Return the error of B at t = 1 in quadruple precision."""
    end = end_point(HeavyTop(reading), methods[method], steps)
    return _norms(end, reference_end(reading)[0])[0]


def _norms(y: Sequence[float | Fraction], exact: Sequence[Fraction]) -> tuple[float, float]:
    """Return the 2-norms of the errors of B and m; differences are taken exactly."""
    difference = np.array([float(Fraction(x) - z) for x, z in zip(y, exact, strict=True)])
    rotation = np.linalg.norm(difference[:9].reshape(3, 3), 2)
    return float(rotation), float(np.linalg.norm(difference[9:]))


def off_group(entries: Sequence[float]) -> float:
    """Return half the 2-norm of BᵀB - I, exact but for the norm itself.

    To first order this is the distance from the group, and rounding can't hide in it.
    """
    rows = [[Fraction(x) for x in entries[3 * i : 3 * i + 3]] for i in range(3)]
    gram = [
        [float(sum(row[i] * row[j] for row in rows) - (i == j)) for j in range(3)] for i in range(3)
    ]
    return float(np.linalg.norm(np.array(gram), 2)) / 2

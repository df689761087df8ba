"""Problems for contests: right-hand sides as a user in a hurry would write them, and solutions."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cg.frames import Frame
from cg.problems import (
    ForcedRigidBody,
    FreeRigidBody,
    GradientFlow,
    HeavyTop,
    ReactionWheels,
    Spacecraft,
    TodaFlow,
    TwoLevelSystem,
)

from .compiled import top_field

__all__ = ["NAMES", "Case", "cases", "top_in_c"]

Array = NDArray[np.float64]
Field = Callable[[float, Any], Any]


@dataclass(frozen=True)
class Case:
    """An initial value problem with its solution at the end.

    Attributes
    ----------
    name : str
        Of files.
    title : str
    frame : Frame
    f : callable
        ``f(t, y)`` returns coefficients.
    y0 : ndarray
    end : float
    exact : ndarray
        The solution at the end, of the shape of ``y0``.
    budget : int
        Largest number of evaluations with fixed steps.
    linear : bool
        Whether the coefficients depend on time alone, so that Magnus methods apply.
    """

    name: str
    title: str
    frame: Frame
    f: Field
    y0: NDArray[Any]
    end: float
    exact: NDArray[Any]
    budget: int = 4096
    linear: bool = False

    def error(self, y: NDArray[Any]) -> float:
        """Return the largest error of an entry of the final point."""
        return float(np.abs(y - self.exact).max())


def cases(names: Iterable[str] | None = None) -> list[Case]:
    """Return all cases, or those of the given names."""
    wanted = _CASES if names is None else {name: _CASES[name] for name in names}
    return [make(name) for name, make in wanted.items()]


def top_in_c(case: Case, folder: Path) -> Case:
    """Return the case of the heavy top with f in C, in a library in the folder."""
    f: Any = top_field(HeavyTop(), folder)
    return replace(case, name="heavy_top_c", title="heavy top, f in C", f=f)


def _top(name: str) -> Case:
    top = HeavyTop()
    return _with_reference(name, "heavy top", top, top.f, 2.0)


def _free(name: str) -> Case:
    body = FreeRigidBody()
    rate1, rate2, rate3 = (body.size / moment for moment in body.inertia)

    def f(t: float, y: Array) -> list[float]:
        u1, u2, u3 = y[9:].tolist()
        w1, w2, w3 = rate1 * u1, rate2 * u2, rate3 * u3
        return [w1, w2, w3, -w1, -w2, -w3]

    return _with_reference(name, "free rigid body", body, f, 2.0)


def _forced(title: str, **parameters: Any) -> Callable[[str], Case]:
    def make(name: str) -> Case:
        body = ForcedRigidBody(**parameters)
        i1, i2, i3 = body.inertia
        (a1, a2, a3), (b1, b2, b3), nu = body.cosine, body.sine, body.frequency

        def f(t: float, y: Array) -> list[float]:
            w1, w2, w3 = y[9:].tolist()
            c, s = math.cos(nu * t), math.sin(nu * t)
            return [
                w1,
                w2,
                w3,
                ((i2 - i3) * w2 * w3 + a1 * c + b1 * s) / i1,
                ((i3 - i1) * w3 * w1 + a2 * c + b2 * s) / i2,
                ((i1 - i2) * w1 * w2 + a3 * c + b3 * s) / i3,
            ]

        return _with_reference(name, title, body, f, 4.0)

    return make


def _spacecraft(name: str) -> Case:
    craft = Spacecraft(stiffness=1.0, damping=1.0)
    (i1, i2, i3), n = craft.inertia, craft.orbit_rate
    pull, kp, kd = 3.0 * n * n, craft.stiffness, craft.damping

    def f(t: float, y: Array) -> list[float]:
        x, z, v, s, w1, w2, w3 = y.tolist()
        r1, r2, r3 = s * s + x * x - z * z - v * v, 2 * (x * z - v * s), 2 * (x * v + z * s)
        h1, h2, h3 = 2 * (x * v - z * s), 2 * (z * v + x * s), s * s + v * v - x * x - z * z
        u1, u2, u3 = w1 - n * h1, w2 - n * h2, w3 - n * h3
        return [
            u1,
            u2,
            u3,
            ((i2 - i3) * (w2 * w3 - pull * r2 * r3) - kp * x - kd * u1) / i1,
            ((i3 - i1) * (w3 * w1 - pull * r3 * r1) - kp * z - kd * u2) / i2,
            ((i1 - i2) * (w1 * w2 - pull * r1 * r2) - kp * v - kd * u3) / i3,
        ]

    return _with_reference(name, "attitude of a spacecraft, controlled", craft, f, 4.0)


def _wheels(name: str) -> Case:
    satellite = ReactionWheels()
    i1, i2, i3 = satellite.inertia
    kp, kd = satellite.stiffness, satellite.damping

    def f(t: float, y: Array) -> list[float]:
        x, z, v, _, w1, w2, w3, h1, h2, h3 = y.tolist()
        u1, u2, u3 = kp * x + kd * w1, kp * z + kd * w2, kp * v + kd * w3
        m1, m2, m3 = i1 * w1 + h1, i2 * w2 + h2, i3 * w3 + h3
        return [
            w1,
            w2,
            w3,
            (m2 * w3 - m3 * w2 - u1) / i1,
            (m3 * w1 - m1 * w3 - u2) / i2,
            (m1 * w2 - m2 * w1 - u3) / i3,
            u1,
            u2,
            u3,
        ]

    return _with_reference(name, "satellite with reaction wheels", satellite, f, 4.0)


def _toda(name: str) -> Case:
    flow = TodaFlow()
    return Case(name, "Toda flow", flow.frame, flow.f, flow.y0, 2.0, flow.exact(2.0), 1024)


def _levels(name: str) -> Case:
    system = TwoLevelSystem()
    a, d, s = system.coupling, system.drive, system.splitting

    def f(t: float, y: Any) -> list[float]:
        return [a * math.cos(d * t), a * math.sin(d * t), s]

    exact = system.exact(4.0)
    return Case(name, "two-level system", system.frame, f, system.y0, 4.0, exact, linear=True)


def _lattice(name: str) -> Case:
    field = GradientFlow((2, 2))
    return _with_reference(name, "SU(3) gradient flow, 2 × 2 sites", field, field.f, 0.5, 1024)


def _with_reference(
    name: str, title: str, problem: Any, f: Field, end: float, budget: int = 4096
) -> Case:
    y0 = problem.y0
    numbers = problem.reference([end], bits=160).y[0]
    exact = numbers[: y0.view(np.float64).size].view(y0.dtype).reshape(y0.shape)
    return Case(name, title, problem.frame, f, y0, end, exact, budget)


_CASES: dict[str, Callable[[str], Case]] = {
    "heavy_top": _top,
    "free_body": _free,
    "slow_torque": _forced("rigid body under a slow torque", frequency=0.5),
    "fast_torque": _forced("rigid body under a fast torque", frequency=4.0),
    "fast_body": _forced("fast rigid body under a torque", velocity=(2.0, -6.0, 4.0)),
    "spacecraft": _spacecraft,
    "wheels": _wheels,
    "toda": _toda,
    "two_levels": _levels,
    "gradient_flow": _lattice,
}

NAMES = tuple(_CASES)
"""The names of all cases."""

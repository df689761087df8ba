"""Test problems of comparisons: right-hand sides in plain Python, and exact solutions."""

from __future__ import annotations

import runpy
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
from numpy.typing import NDArray

import cg
from cg.frames import SO3, Euclidean, Frame, Product
from cg.problems import FreeRigidBody, HeavyTop

GALLERY = Path(__file__).parents[1] / "docs" / "gallery"

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
    """

    name: str
    title: str
    frame: Frame
    f: Field
    y0: NDArray[Any]
    end: float
    exact: NDArray[Any]

    def error(self, y: NDArray[Any]) -> float:
        """Return the largest error of an entry of the final point."""
        return float(np.abs(y - self.exact).max())


def cases(names: Iterable[str] | None = None) -> list[Case]:
    """Return all cases, or those of the given names."""
    makers = _CASES if names is None else {name: _CASES[name] for name in names}
    return [make(name) for name, make in makers.items()]


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


def _forced(
    title: str, frequency: float = 1.0, velocity: tuple[float, ...] = (0.5, -1.0, 0.75)
) -> Callable[[str], Case]:
    """Return a function that makes the case of a body under a torque that rotates."""
    frame = Product(SO3(), Euclidean(3))
    inertia = np.array([1.0, 1.5, 2.0])
    cosine, sine = np.array([0.5, -0.25, 0.125]), np.array([-0.25, 0.5, 0.25])

    def f(t: float, y: Array) -> Array:
        torque = np.cos(frequency * t) * cosine + np.sin(frequency * t) * sine
        omega = y[9:]
        return np.concatenate([omega, (np.cross(inertia * omega, omega) + torque) / inertia])

    def make(name: str) -> Case:
        y0 = frame.join(np.eye(3), np.array(velocity))
        return Case(name, title, frame, f, y0, 4.0, _converged(frame, f, y0, 4.0))

    return make


def _script(script: str, title: str, end: float, *, flow: str = "") -> Callable[[str], Case]:
    """Return a function that makes the case of an example in ``docs/gallery``."""

    def make(name: str) -> Case:
        names = runpy.run_path(str(GALLERY / f"{script}.py"))
        example = names[flow]() if flow else SimpleNamespace(**names)
        if hasattr(example, "exact"):
            exact = example.exact(end)
        else:
            exact = _converged(example.frame, example.f, example.y0, end)
        return Case(name, title, example.frame, example.f, example.y0, end, exact)

    return make


def _converged(frame: Frame, f: Field, y0: Array, end: float) -> Array:
    """Return the end of an integration with steps so short that only rounding is left."""
    method, h = "RKMK8(5,3)", end / 256
    run = cg.integrate(f, (0.0, end), y0, frame=frame, method=method, h=h, save_every=256)
    return np.asarray(run.y[-1])


def _with_reference(name: str, title: str, problem: Any, f: Field, end: float) -> Case:
    y0 = problem.y0
    exact = problem.reference([end], bits=160).y[0][: y0.size]
    return Case(name, title, problem.frame, f, y0, end, exact)


_CASES: dict[str, Callable[[str], Case]] = {
    "heavy_top": _top,
    "free_body": _free,
    "slow_torque": _forced("rigid body under a slow torque", frequency=0.5),
    "fast_torque": _forced("rigid body under a fast torque", frequency=4.0),
    "fast_body": _forced("fast rigid body under a torque", velocity=(2.0, -6.0, 4.0)),
    "spacecraft": _script("spacecraft", "attitude of a spacecraft, controlled", 4.0),
    "wheels": _script("reaction_wheels", "satellite with reaction wheels", 4.0),
    "toda": _script("toda", "Toda flow", 2.0),
    "two_levels": _script("two_levels", "two-level system", 4.0),
    "gradient_flow": _script(
        "gradient_flow", "SU(3) gradient flow, 2 × 2 sites", 0.5, flow="GradientFlow"
    ),
}

"""Adaptive steps on the heavy top, with right-hand sides in C and in Python."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

import cg
from cg.integration import EnsembleSolution, Solution
from cg.integration.compiled_rhs import compiled_rhs
from cg.problems import HeavyTop

from .compiled_top import CompiledTop
from .record import Result, Row
from .timing import measure

_END = 20.0
_TOLERANCE = 1e-6
_METHOD = "CG4(3)"
_MEMBERS = 100


def run(quick: bool, figures: Path | None) -> Result:
    """Measure time per accepted step, and the error of what is computed."""
    rounds = 3 if quick else 11
    top = HeavyTop()
    ensemble = np.broadcast_to(top.y0, (_MEMBERS, *top.y0.shape))
    with tempfile.TemporaryDirectory() as folder:
        compiled = CompiledTop(top, Path(folder))
        called = compiled_rhs(compiled.f)
        assert called is not None
        on_frame = called.on(top.frame, None)

        def from_python(t: float, y: Any) -> Any:
            return on_frame(t, y)

        settings: dict[str, Any] = {
            "frame": top.frame, "method": _METHOD, "rtol": _TOLERANCE, "atol": _TOLERANCE,
        }  # fmt: skip

        def solve(f: Any) -> Solution:
            return cg.solve_ivp(f, (0.0, _END), top.y0, **settings)

        def solve_many() -> EnsembleSolution:
            return cg.solve_ensemble(compiled.f, (0.0, _END), ensemble, t_eval=[_END], **settings)

        contestants: dict[str, Callable[[], Solution | EnsembleSolution]] = {
            "compiled": lambda: solve(compiled.f),
            "called": lambda: solve(from_python),
            "Python": lambda: solve(top.f),
            "ensemble": solve_many,
        }
        found = {name: contestant() for name, contestant in contestants.items()}
        times = measure(contestants, rounds=rounds, seconds=0.15)
    exact = np.array(top.reference([_END]).y)[0]
    steps = {name: int(np.sum(solution.steps)) for name, solution in found.items()}

    def row(name: str, other: str, quantity: str, against: str) -> Row:
        return Row(
            quantity,
            1e6 * times.median(name) / steps[name],
            "µs a step",
            against,
            1e6 * times.median(other) / steps[other],
            times.ratio(other, name) * steps[name] / steps[other],
        )

    errors = ", ".join(
        f"{name} {np.abs(solution.y[-1] - exact).max():.1e} after {solution.steps} steps"
        for name, solution in found.items()
        if name != "ensemble"
    )
    loop = "the same loop, "
    whole = "compiled right-hand side"
    members = f"the same for {_MEMBERS} trajectories, each with its own steps"
    return Result(
        "Heavy top, adaptive steps",
        f"`{_METHOD}` with tolerances of {_TOLERANCE:g} to t = {_END:g}, every step stored, but of "
        f"the ensemble the ends. Medians of {rounds} rounds; time per accepted step.",
        (
            row("compiled", "Python", whole, loop + "right-hand side in Python"),
            row("compiled", "called", whole, loop + "compiled right-hand side, called from Python"),
            row("ensemble", "compiled", members, "one trajectory"),
        ),
        (f"- Largest error at the end: {errors}.",),
    )

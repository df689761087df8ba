"""Time per step of CG4a on the heavy top: compiled, in Python, by hand in C, by Lielab."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import cg
from cg.problems import HeavyTop

from . import lielab_top
from .compiled_top import CompiledTop
from .record import Aim, Result, Row
from .timing import measure

_H = 0.01
_COMPILED_STEPS, _PYTHON_STEPS = 20_000, 500
_END = 5.0


def run(quick: bool, figures: Path | None) -> Result:
    """Measure time per step, and the error of what is computed."""
    rounds = 3 if quick else 11
    top = HeavyTop()
    method = cg.methods["CG4a"]
    assert isinstance(method, cg.Tableau)
    with tempfile.TemporaryDirectory() as folder:
        compiled = CompiledTop(top, Path(folder))

        def ours(f: object, steps: int) -> NDArray[np.float64]:
            solution = cg.integrate(
                f,  # type: ignore[arg-type]
                (0.0, steps * _H),
                top.y0,
                frame=top.frame,
                method=method,
                h=_H,
            )
            return solution.y

        contestants: dict[str, Callable[[int], NDArray[np.float64]]] = {
            "compiled": lambda steps: ours(compiled.f, steps),
            "C": lambda steps: compiled.integrate(method, _H, steps),
            "Python": lambda steps: ours(top.f, steps),
        }
        if lielab_top.available():
            lielab = lielab_top.LielabTop(top)
            contestants["Lielab"] = lambda steps: lielab.integrate(_H, steps)
        steps = {
            name: _COMPILED_STEPS if name in ("compiled", "C") else _PYTHON_STEPS
            for name in contestants
        }
        exact = np.array(top.reference([_END]).y)[0]
        errors = {
            name: float(np.abs(contestant(round(_END / _H))[-1] - exact).max())
            for name, contestant in contestants.items()
        }
        times = measure(
            {
                name: lambda name=name: contestants[name](steps[name])  # type: ignore[misc]
                for name in contestants
            },
            rounds=rounds,
            seconds=0.15,
        )

    def row(quantity: str, name: str, other: str, against: str, aim: Aim) -> Row:
        ratio = times.ratio(other, name) * steps[name] / steps[other]
        return Row(
            quantity,
            1e6 * times.median(name) / steps[name],
            "µs a step",
            against,
            1e6 * times.median(other) / steps[other],
            ratio if aim.above else 1.0 / ratio,
            aim=aim,
        )

    rows = [
        row("compiled right-hand side", "compiled", "C", "plain loop in C", Aim(1.5, above=False))
    ]
    if "Lielab" in contestants:
        version = "Lielab, Python right-hand side"
        rows += [
            row("compiled right-hand side", "compiled", "Lielab", version, Aim(60, above=True)),
            row("Python right-hand side", "Python", "Lielab", version, Aim(2, above=True)),
        ]
    notes = [
        f"- Largest error at t = {_END:g}: "
        + ", ".join(f"{name} {error:.1e}" for name, error in errors.items())
        + "."
    ]
    if "Lielab" in contestants:
        notes.append(
            "- Lielab moves the top by angular velocities in space axes, the others in body axes; "
            "hence the other error, of the same order four, for the same work."
        )
    else:
        notes.append("- Lielab was not installed, and is left out (`pip install lielab==0.5.2`).")
    return Result(
        "Heavy top, CG4a, time per step",
        f"A step has 15 exponentials and 5 evaluations; h = {_H}, every step stored. "
        f"Medians of {rounds} rounds; the loop in C is `benchmarks/heavy_top.c`, by gcc -O3.",
        tuple(rows),
        ("\n".join(notes),),
    )

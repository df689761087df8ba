"""Fixed steps, compared with a plain loop in C that takes the same steps, and with Lielab."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np

import cg
from cg.frames import Euclidean, Product, UnitQuaternion
from cg.problems import HeavyTop

from . import lielab_top
from .in_c import PlainLoop, field, top_field
from .record import Aim, Result, Row
from .timing import measure

_H = 0.01
_STEPS = {"C": 20_000, "Python": 500, "Lielab": 500}
_BODY = Product(UnitQuaternion(), Euclidean(3))
_MEMBER_STEPS = 10
_LIMIT = Aim(1.4, above=False)

TITLE = "Steps against C"


def method_text(rounds: int) -> str:
    """Return how steps are measured."""
    return (
        "The loop in C is `benchmarks/steps.c`, compiled by gcc -O3 like the package. It "
        "multiplies the same quaternions, with the sine and cosine of the C library where the "
        "package has series for small angles, calls `f` by a pointer to a function of another "
        "library, and does nothing else. The heavy top takes "
        f"{_STEPS['C']} steps of {_H:g} and stores the "
        f"last point, medians of {rounds} rounds; each of the bodies, with its own attitude and "
        f"momentum, takes {_MEMBER_STEPS} steps and stores the end, one core, medians of 3 rounds. "
        "Lielab calls `f` in Python."
    )


def run(quick: bool, figures: Path | None) -> Result:
    """Measure time per step of one top, and of a million bodies."""
    rounds = 3 if quick else 11
    with tempfile.TemporaryDirectory() as folder:
        loop = PlainLoop(Path(folder))
        rows = _top(rounds, Path(folder), loop)
        rows.append(_members(10_000 if quick else 1_000_000, Path(folder), loop))
    absent = "- Lielab was not installed, so there is no comparison with it."
    return Result(
        TITLE, method_text(rounds), tuple(rows), () if lielab_top.available() else (absent,)
    )


def _top(rounds: int, folder: Path, loop: PlainLoop) -> list[Row]:
    top = HeavyTop()
    f, start = top_field(top, folder), top.y0[None]

    def steps(method: str, f: object, count: int) -> Callable[[], object]:
        return lambda: cg.integrate(
            f, (0.0, count * _H), top.y0, frame=top.frame, method=method, h=_H, save_every=count  # type: ignore[arg-type]
        )  # fmt: skip

    contestants: dict[str, Callable[[], object]] = {}
    for method in ("CF4", "CG4a"):
        contestants[f"{method}, here"] = steps(method, f, _STEPS["C"])
        contestants[f"{method}, C"] = lambda method=method: loop.integrate(  # type: ignore[misc]
            f, method, _H, _STEPS["C"], start
        )
    contestants["CG4a, Python"] = steps("CG4a", top.f, _STEPS["Python"])
    if lielab_top.available():
        lielab = lielab_top.LielabTop(top)
        contestants["CG4a, Lielab"] = lambda: lielab.integrate(_H, _STEPS["Lielab"])
    times = measure(contestants, rounds=rounds)

    c, python, lielabs = _STEPS["C"], _STEPS["Python"], _STEPS["Lielab"]
    rows = [
        times.row(
            f"`{method}`, heavy top, `f` in C", f"{method}, here", "µs per step", "plain loop in C",
            f"{method}, C", pieces=(c, c), aim=_LIMIT, above=False,
        )
        for method in ("CF4", "CG4a")
    ]  # fmt: skip
    if "CG4a, Lielab" in contestants:
        rows += [
            times.row(
                f"`CG4a`, heavy top, `f` in {what}", f"CG4a, {label}", "µs per step", "Lielab",
                "CG4a, Lielab", pieces=(count, lielabs), aim=Aim(bound, above=True),
            )
            for what, label, count, bound in (("C", "here", c, 60), ("Python", "Python", python, 2))
        ]  # fmt: skip
    return rows


def _members(members: int, folder: Path, loop: PlainLoop) -> Row:
    f, h = field("free_body", folder, [1.0, 0.5, 0.4]), 0.05
    points = _BODY.random_point(np.random.default_rng(1), (members,))
    end = _MEMBER_STEPS * h
    times = measure(
        {
            "here": lambda: cg.solve_ensemble(
                f, (0.0, end), points, frame=_BODY, method="CF4", h=h, t_eval=[end]
            ),
            "C": lambda: loop.integrate(f, "CF4", h, _MEMBER_STEPS, points),
        },
        rounds=3,
        warm_up=False,
    )
    return times.row(
        f"`CF4`, {members} free rigid bodies", "here", "µs per step", "plain loop in C", "C",
        pieces=2 * (members * _MEMBER_STEPS,), aim=_LIMIT, above=False,
    )  # fmt: skip

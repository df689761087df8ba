"""The cost of derivatives of solutions, compared with the solution and with differences."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

import cg
from cg.frames import SO3, Frame
from cg.problems import HeavyTop

from .in_c import top_field
from .record import Aim, Result, Row
from .timing import Times, measure

_STEP = 1e-4

TITLE = "Derivatives of solutions"


def method_text(rounds: int) -> str:
    """Return how derivatives are measured."""
    return (
        "The time of `cg.solve_variational` to t = 10 at `rtol = atol = 1e-8`, divided by that of "
        "`cg.solve_ivp` (smaller is better), and compared with n + 1 solutions whose differences "
        "give the transition matrix to half as many digits (larger is better). The heavy top has n "
        "= 6 coordinates, the rotation 3. Without `jac` the variational equation needs 2 n "
        f"additional evaluations. Medians of {rounds} rounds."
    )


def run(quick: bool, figures: Path | None) -> Result:
    """Measure processor time of transition matrices."""
    rounds = 3 if quick else 11
    top = HeavyTop()
    options = {"frame": top.frame, "t_eval": [10.0], "rtol": 1e-8, "atol": 1e-8}
    with tempfile.TemporaryDirectory() as folder:
        f = top_field(top, Path(folder))
        jac = top_field(top, Path(folder), "heavy_top_jac")
        body = SO3()
        rate = {"frame": body, "t_eval": [10.0], "rtol": 1e-8, "atol": 1e-8}
        contestants = {
            **_contest("compiled", f, top.y0, top.frame, options, jac=jac),
            **_contest("python", top.f, top.y0, top.frame, options),
            **_contest("rotation", _turn, np.eye(3), body, rate, jac=_turn_jac),
        }
        times = measure(contestants, rounds=rounds, seconds=0.1)
    return Result(
        TITLE,
        method_text(rounds),
        (
            *_rows(times, "compiled", "heavy top in C", 6, jac=True),
            *_rows(times, "python", "heavy top in Python", 6),
            *_rows(times, "rotation", "rotation in Python", 3, jac=True),
        ),
    )


def _turn(t: float, y: Any) -> Any:
    return [0.5 * y[0, 1], np.cos(t), y[2, 2]]


def _turn_jac(t: float, y: Any) -> Any:
    # column j: the derivative where y moves along field j, y -> y hat(e_j)
    return [[-0.5 * y[0, 2], 0.0, 0.5 * y[0, 0]], [0.0, 0.0, 0.0], [y[2, 1], -y[2, 0], 0.0]]


def _contest(
    name: str, f: Any, y0: Any, frame: Frame, options: dict[str, Any], jac: Any = None
) -> dict[str, Callable[[], object]]:
    """Return the computations of a solution and of its transition matrix."""

    def differences() -> None:
        ends = [cg.solve_ivp(f, (0, 10), y0, **options).y[-1]]
        for e in np.eye(frame.dim):
            start = frame.flow(_STEP * e, y0)
            ends.append(cg.solve_ivp(f, (0, 10), start, **options).y[-1])
        frame.local_coordinates(ends[0], np.array(ends[1:]))

    ways: dict[str, Callable[[], object]] = {
        name: lambda: cg.solve_ivp(f, (0, 10), y0, **options),
        f"{name}, differences": differences,
        f"{name}, estimated": lambda: cg.solve_variational(f, (0, 10), y0, **options),
    }
    if jac is not None:
        ways[f"{name}, exact"] = lambda: cg.solve_variational(f, (0, 10), y0, jac=jac, **options)
    return ways


def _rows(times: Times, name: str, title: str, n: int, jac: bool = False) -> list[Row]:
    rows = []
    for way, text in (("exact", "`jac`"), ("estimated", "no `jac`")):
        if way == "exact" and not jac:
            continue
        key = f"{name}, {way}"
        bounded = name == "compiled" and way == "exact"
        aim = Aim(2.0 + n / 3.0, above=False) if bounded else None
        by_differences = f"{name}, differences"
        for other, against, ratio in (
            (name, "the solution", times.ratio(key, name)),
            (by_differences, f"{n + 1} solutions", times.ratio(by_differences, key)),
        ):
            rows.append(Row(
                f"{title}, {text}", 1e3 * times.median(key), "ms", against,
                1e3 * times.median(other), ratio, aim=aim if other == name else None,
            ))  # fmt: skip
    return rows

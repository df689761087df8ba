"""What the loop over steps costs beside f, on frames whose flows are compiled."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from scipy.integrate import DOP853, solve_ivp

import cg
from cg.frames import SO3, Euclidean, Product
from cg.integration import Solution

from .record import Aim, Result, Row
from .timing import Times, measure

_FRAME = Product(SO3(), Euclidean(3))
_STEPS = 400
_H = 0.05
_SPLITS = 1000


def run(quick: bool, figures: Path | None) -> Result:
    """Measure processor time per evaluation of a right-hand side that does nothing."""
    rounds = 3 if quick else 11
    constant = np.linspace(0.1, 0.6, 6)
    numbers = np.ones(12)
    y0 = _FRAME.join(np.eye(3), np.zeros(3))
    span = (0.0, _STEPS * _H)

    def trivial(t: float, y: Any) -> Any:
        return constant

    def flat(t: float, y: Any) -> Any:
        return numbers

    def with_split(t: float, y: Any) -> Any:
        _FRAME.split(y)
        return constant

    def fixed(f: Callable[..., Any], method: str) -> Callable[[], Solution]:
        return lambda: cg.integrate(f, span, y0, frame=_FRAME, method=method, h=_H)

    def adaptive(method: str) -> Callable[[], Solution]:
        return lambda: cg.solve_ivp(
            trivial, span, y0, frame=_FRAME, method=method, max_step=_H, first_step=_H
        )

    def split() -> None:
        for _ in range(_SPLITS):
            _FRAME.split(y0)

    methods = {name: fixed(trivial, name) for name in ("CF4", "CG4a", "CG6f", "CG7b")}
    pairs = {name: adaptive(name) for name in ("CG4(3)", "CG6(5)")}
    contestants: dict[str, Callable[[], Any]] = {
        **methods,
        **pairs,
        "split": fixed(with_split, "CG6f"),
        "SciPy": lambda: solve_ivp(
            flat, span, numbers, method=DOP853, max_step=_H, first_step=_H, rtol=1e-3, atol=1e-3
        ),
    }
    found = {name: contestant() for name, contestant in contestants.items()}
    times = measure({**contestants, "only split": split}, rounds=rounds, seconds=0.1)
    each = {name: 1.0 / solution.nfev for name, solution in found.items()}
    rows = [
        _row(times, each, name, f"`{name}`, {found[name].nexp / found[name].nfev:.3g} flows")
        for name in (*methods, *pairs)
    ]
    rows.append(_row(times, each, "split", "`CG6f`, and an f that calls `frame.split`"))
    rows.append(
        Row(
            "`frame.split` alone",
            1e6 * times.median("only split") / _SPLITS,
            "µs",
            aim=Aim(1.0, above=False, of="value"),
        )
    )
    return Result(
        "The loop beside f",
        "Rotations and three numbers, SO(3) × R³, with a right-hand side in Python that returns a "
        "constant; SciPy's `DOP853` on twelve numbers, which are as many as a point has. "
        f"{_STEPS} steps; medians of {rounds} rounds; time per evaluation, that of f included.",
        tuple(rows),
    )


def _row(times: Times, each: dict[str, float], name: str, quantity: str) -> Row:
    return Row(
        quantity,
        1e6 * times.median(name) * each[name],
        "µs",
        "SciPy's DOP853",
        1e6 * times.median("SciPy") * each["SciPy"],
        times.ratio("SciPy", name) * each["SciPy"] / each[name],
        aim=Aim(4.0 / 3.0, above=True),
    )

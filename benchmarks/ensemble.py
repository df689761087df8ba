"""Many tops at once: time of one of them against a top alone."""

from __future__ import annotations

import tempfile
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import cg
from cg.problems import HeavyTop

from .compiled_top import CompiledTop
from .record import Result, Row
from .timing import measure

_H = 0.01
_STEPS = 20
_SPAN = (0.0, 1.0)
_OUTPUT: dict[str, dict[str, Any]] = {
    "the end": {},
    "output at ten times": {"t_eval": np.linspace(*_SPAN, 11)[1:]},
    "a continuous solution": {"dense_output": True},
}


def run(quick: bool, figures: Path | None) -> Result:
    """Measure an ensemble and a top alone, with a right-hand side in NumPy and in C."""
    rounds, members = (2, 1_000) if quick else (7, 10_000)
    top = HeavyTop()
    method = cg.methods["CG4a"]
    inverse = np.array([float(1 / moment) for moment in top.inertia])
    mgl = float(top.mgl)

    def f(t: float, y: NDArray[np.float64]) -> NDArray[np.float64]:
        m = y[..., 9:]
        rates = np.empty((*y.shape[:-1], 6))
        rates[..., :3] = inverse * m
        w = rates[..., :3]
        rates[..., 3] = m[..., 1] * w[..., 2] - m[..., 2] * w[..., 1] + mgl * y[..., 7]
        rates[..., 4] = m[..., 2] * w[..., 0] - m[..., 0] * w[..., 2] - mgl * y[..., 6]
        rates[..., 5] = m[..., 0] * w[..., 1] - m[..., 1] * w[..., 0]
        return rates

    rng = np.random.default_rng(1)
    many = top.frame.random_point(rng, (members,))

    def integrate(right_side: Any, steps: int) -> None:
        cg.integrate(
            right_side, (0.0, steps * _H), top.y0, frame=top.frame, method=method, h=_H,
            save_every=steps,
        )  # fmt: skip

    def integrate_many(right_side: Any, vectorized: bool) -> None:
        cg.solve_ensemble(
            right_side, (0.0, _STEPS * _H), many, frame=top.frame, method=method, h=_H,
            vectorized=vectorized,
        )  # fmt: skip

    def choose(right_side: Any, y0: NDArray[np.float64], output: str) -> None:
        """Integrate in steps that each top chooses."""
        cg.solve_ensemble(right_side, _SPAN, y0, frame=top.frame, rtol=1e-8, **_OUTPUT[output])

    def loop(right_side: Any, y0: NDArray[np.float64], output: str) -> None:
        for point in y0:
            cg.solve_ivp(right_side, _SPAN, point, frame=top.frame, rtol=1e-8, **_OUTPUT[output])

    few = many[: members // 20]
    with tempfile.TemporaryDirectory() as folder:
        compiled = CompiledTop(top, Path(folder)).f
        alone = {"NumPy": 500, "compiled": 20_000}
        times = measure(
            {
                "NumPy, many": lambda: integrate_many(f, True),
                "NumPy, one": lambda: integrate(f, alone["NumPy"]),
                "compiled, many": lambda: integrate_many(compiled, False),
                "compiled, one": lambda: integrate(compiled, alone["compiled"]),
            },
            rounds=rounds,
            seconds=0.2,
        )
        chosen = measure(
            {
                f"{output}, {count}": partial(
                    loop if count == "one" else choose, compiled, few, output
                )
                for output in _OUTPUT
                for count in ("many", "one")
            },
            rounds=rounds,
            seconds=0.2,
        )
    rows = []
    for kind, quantity in (
        ("NumPy", "right-hand side in NumPy"),
        ("compiled", "compiled right-hand side"),
    ):
        each = members * _STEPS
        rows.append(
            Row(
                f"{quantity}, {members} tops",
                1e6 * times.median(f"{kind}, many") / each,
                "µs a step of a top",
                "one top alone",
                1e6 * times.median(f"{kind}, one") / alone[kind],
                times.ratio(f"{kind}, one", f"{kind}, many") * each / alone[kind],
            )
        )
    rows += [
        Row(
            f"compiled right-hand side, {len(few)} tops, steps of their own: {output}",
            1e3 * chosen.median(f"{output}, many") / len(few),
            "ms a top",
            "one call for each top",
            1e3 * chosen.median(f"{output}, one") / len(few),
            chosen.ratio(f"{output}, one", f"{output}, many"),
        )
        for output in _OUTPUT
    ]
    return Result(
        "Ensembles",
        f"CG4a on {members} tops with random attitudes and momenta, {_STEPS} steps, one "
        f"thread; steps of their own: the default method, rtol 1e-8, t from 0 to 1. Medians of "
        f"{rounds} rounds.",
        tuple(rows),
    )

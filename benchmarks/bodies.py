"""Rigid bodies at equal errors: f in C against diffrax, f in Python against SciPy's DOP853."""

from __future__ import annotations

import importlib.util
import math
import tempfile
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

import cg
from cg.frames import Euclidean, Product, UnitQuaternion

from .cases import Case, cases
from .in_c import field
from .record import Aim, Result, Row
from .solvers import Run, solvers
from .work_curves import run_curves

_INERTIA = (1.0, 2.0, 2.5)
_MOMENTUM = (1.0, 4.0, -1.25)  # angular velocity (1, 2, -0.5)
_TORQUES = ("slow_torque", "fast_torque", "fast_body")
_OWN, _PROJECTED = "default of solve_ivp", "DOP853, projected"
_TUMBLING_AIMS = {1e-6: 1.0, 1e-8: 1.5, 1e-10: 1.5}
_TORQUE_AIMS = {1e-6: 1.3, 1e-8: 1.6, 1e-11: 1.6}

TITLE = "Rigid bodies at equal errors"

Solvers = dict[str, Callable[[float], Run]]


def method_text(rounds: int) -> str:
    """Return how the times are measured."""
    return (
        "Times of the default method of `cg.solve_ivp` for a given error at the end, by "
        "interpolation between runs with tolerances from 1e-3 to 1e-13; medians of "
        f"{rounds} rounds of all solvers in turn. The tumbling body is a unit quaternion and a "
        f"momentum, with moments of inertia {_INERTIA} and initial angular velocity (1, 2, -0.5), "
        "`f` in C, and stores the end only. It is compared with the faster of diffrax's Dopri8 and "
        "Tsit5, jitted, in double precision on the seven numbers, with the adjoint `ForwardMode` "
        "and without the time for compilation. The bodies under a torque, with `f` in Python, "
        "store every step, and are compared with SciPy's DOP853 with projection after each step."
    )


def run(quick: bool, figures: Path | None) -> Result:
    """Compare times at equal errors at the end."""
    rounds = 3 if quick else 21
    rows: list[Row] = []
    notes: tuple[str, ...] = ()
    if importlib.util.find_spec("diffrax") is not None:
        with tempfile.TemporaryDirectory() as folder:
            case = tumbling(Path(folder))
            solve = diffrax_solvers(case) | {_OWN: _solve(case)}
            rows += _rows(case, solve, _TUMBLING_AIMS, rounds)
    else:
        notes = ("- diffrax was not installed, so there is no comparison with it.",)
    for case in cases(_TORQUES):
        pair = {s.name: s.solve for s in solvers(case, quick) if s.name in (_OWN, _PROJECTED)}
        rows += _rows(case, pair, _TORQUE_AIMS, rounds)
    return Result(TITLE, method_text(rounds), tuple(rows), notes)


def tumbling(folder: Path) -> Case:
    """Return the tumbling body, with f in C in a library in the folder."""
    frame = Product(UnitQuaternion(), Euclidean(3))
    f: Any = field("free_body", folder, [1.0 / moment for moment in _INERTIA])
    y0, end = np.array([0.0, 0.0, 0.0, 1.0, *_MOMENTUM]), 50.0
    exact = cg.integrate(
        f, (0.0, end), y0, frame=frame, method="RKMK8(5,3)", h=end / 4096, save_every=4096
    ).y[-1]
    return Case("tumbling", f"body that tumbles for {end:g} s", frame, f, y0, end, exact)


def _solve(case: Case) -> Callable[[float], Run]:
    def solve(tolerance: float) -> Run:
        solution = cg.solve_ivp(
            case.f, (0.0, case.end), case.y0, frame=case.frame, rtol=tolerance, atol=tolerance,
            t_eval=[case.end],
        )  # fmt: skip
        return Run(solution.y, solution.nfev, solution.nexp)

    return solve


def diffrax_solvers(case: Case) -> Solvers:
    """Return diffrax's solvers of the tumbling body, compiled."""
    import diffrax
    import jax
    import jax.numpy as jnp

    jax.config.update("jax_enable_x64", True)
    i1, i2, i3 = _INERTIA

    def f(t: Any, y: Any, args: Any) -> Any:
        x, z, v, s, m1, m2, m3 = y
        a, b, c = m1 / i1, m2 / i2, m3 / i3
        quaternion = (s * a + z * c - v * b, s * b + v * a - x * c, s * c + x * b - z * a)
        last = -x * a - z * b - v * c
        momentum = (m2 * c - m3 * b, m3 * a - m1 * c, m1 * b - m2 * a)
        return jnp.stack([*(0.5 * rate for rate in (*quaternion, last)), *momentum])

    def compiled(solver: Any) -> Callable[[float], Run]:
        @jax.jit  # type: ignore[untyped-decorator]
        def end(tolerance: Any, y0: Any) -> Any:
            return diffrax.diffeqsolve(
                diffrax.ODETerm(f), solver, 0.0, case.end, None, y0, max_steps=1_000_000,
                stepsize_controller=diffrax.PIDController(rtol=tolerance, atol=tolerance),
                adjoint=diffrax.ForwardMode(),
            ).ys  # fmt: skip

        def solve(tolerance: float) -> Run:
            return Run(np.asarray(end(tolerance, case.y0)), 0, 0)

        solve(0.1)  # compiles it
        return solve

    return {
        f"diffrax's {solver}": compiled(getattr(diffrax, solver)())
        for solver in ("Dopri8", "Tsit5")
    }


def _rows(case: Case, solve: Solvers, aims: Mapping[float, float], rounds: int) -> list[Row]:
    curves = run_curves(case, solve, [10.0**-k for k in range(3, 14)], rounds)
    ours = curves.pop(_OWN)
    rows = []
    for error, aim in aims.items():
        here = ours.at(error, "time")
        there, name = min(
            ((curve.at(error, "time"), name) for name, curve in curves.items()),
            key=lambda pair: (math.isnan(pair[0]), pair),
        )
        rows.append(
            Row(
                f"{case.title}, error {error:g}",
                1e3 * here, "ms", name, 1e3 * there, there / here, aim=Aim(aim, above=True),
            )
        )  # fmt: skip
    return rows

"""Steps, gradients and batches in JAX, compared with diffrax's own solvers."""

from __future__ import annotations

import contextlib
import importlib.util
import tempfile
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np

import cg

from .bodies import tumbling
from .cases import Case
from .record import Aim, Result, Row
from .timing import measure

with contextlib.suppress(ImportError):  # without them nothing is measured
    import diffrax
    import jax
    import jax.numpy as jnp

_INERTIA = np.array([1.0, 2.0, 2.5])
_START = np.array([0.0, 0.0, 0.0, 1.0, 1.0, 2.0, -0.5])
_METHODS = ("CF5(4)", "RKMK5(4)", "RKMK8(5,3)", "CF7(6)")
_RIVALS = ("Dopri8", "Tsit5")
_DEFAULT = "RKMK8(5,3)"
_AIMS = {1e-6: 1.1, 1e-8: 1.6, 1e-10: 2.5}
_MEMBERS = 1000
_SIZES = (1_000, 100_000)
_KEPT = 10_000  # steps
_ERROR = 1e-6  # of a gradient, and of members

TITLE = "In JAX"
METHOD = (
    "The tumbling body of *Rigid bodies at equal errors*, as a quaternion and an angular velocity, "
    "in float64 on the CPU, jitted, storing the end only. Its coefficients do not depend on the "
    "attitude but in the row with torques. Competitors are diffrax's Dopri8 and Tsit5 on the seven "
    "numbers, which they do not normalise. Tolerances are the largest, of 10^(-k/4), with the "
    f"given error at the end, and times medians of rounds in turn. The {_MEMBERS} members differ "
    "in inertia. Compiling includes tracing, in processor time."
)

Solve = Callable[..., Any]
Functions = dict[str, Callable[[float], Any]]


def run(quick: bool, figures: Path | None) -> Result:
    """Compare times at equal errors, of gradients, of batches and of compiling."""
    rows: tuple[Row, ...] = ()
    notes: tuple[str, ...] = ()
    if importlib.util.find_spec("diffrax") is None:
        notes = ("- diffrax was not installed, so nothing was measured.",)
    else:
        rounds = 3 if quick else 5
        rows = (
            *_ends(rounds), _gradients(rounds), *_batches(rounds), *_ensembles(3, quick),
            *_memory(), *_compiling(3),
        )  # fmt: skip
    return Result(TITLE, METHOD, rows, notes)


def _solvers(unroll: bool = False, torque: float = 0.0) -> dict[str, tuple[Solve, bool]]:
    """Return functions of tolerance, start, inertia and end, each with whether it uses `cg.jax`."""
    jax.config.update("jax_enable_x64", True)
    frame = cg.frames.Product(cg.frames.UnitQuaternion(), cg.frames.Euclidean(3))
    generators = cg.frames.UnitQuaternion().field(np.eye(3), np.eye(4)[:, None])

    def euler(t: Any, y: Any, inertia: Any) -> Any:
        free = jnp.cross(inertia * y[4:], y[4:])
        return (free + torque * (y[:3] + jnp.sin(t)) if torque else free) / inertia

    def coefficients(t: Any, y: Any, inertia: Any) -> Any:
        return jnp.concatenate([y[4:], euler(t, y, inertia)])

    def derivative(t: Any, y: Any, inertia: Any) -> Any:
        matrix = jnp.tensordot(y[4:], jnp.asarray(generators), (0, 1))
        return jnp.concatenate([y[:4] @ matrix, euler(t, y, inertia)])

    def solving(term: Any, solver: Any, own: bool) -> Solve:
        def solve(tolerance: Any, y0: Any, inertia: Any, end: Any, adjoint: Any) -> Any:
            pid = diffrax.PIDController(rtol=tolerance, atol=tolerance)
            control = cg.jax.controller(frame, tolerance, tolerance) if own else pid
            return diffrax.diffeqsolve(
                term, solver, 0.0, end, None, y0, inertia, stepsize_controller=control,
                max_steps=100_000, adjoint=adjoint,
            ).ys[-1]  # fmt: skip

        return solve

    solvers = {}
    for name in _METHODS:
        solver = cg.jax.Solver(name, dense="steps", unroll=unroll)
        solvers[name] = solving(cg.jax.FrameTerm(coefficients, frame), solver, True), True
    for name in _RIVALS:
        term = diffrax.ODETerm(derivative)
        solvers[name] = solving(term, getattr(diffrax, name)(), False), False
    return solvers


def _at_error(functions: Functions, exact: Any, error: float) -> dict[str, float]:
    """Return for each function the largest tolerance, of 10^(-k/4), at which the error is small."""
    tolerances = {}
    for name, function in functions.items():
        for tolerance in 10.0 ** -np.arange(2.0, 13.0, 0.25):
            if np.abs(np.asarray(function(tolerance)) - exact).max() <= error:
                tolerances[name] = tolerance
                break
    return tolerances


def _compare(
    title: str, functions: Functions, exact: Any, rounds: int, *, error: float = _ERROR,
    pieces: int = 1, aim: float = 1.0,
) -> Row:  # fmt: skip
    """Compare the fastest method of `cg.jax` with the fastest of others, for the same error."""
    tolerances = _at_error(functions, exact, error)
    calls = {
        name: lambda f=functions[name], t=tolerance: np.asarray(f(t))
        for name, tolerance in tolerances.items()
    }
    times = measure(calls, rounds=rounds)
    here = [name for name in calls if name in _METHODS]
    own = min(here, key=times.median)
    rival = min((name for name in calls if name not in here), key=times.median)
    return times.row(
        f"{title}, error {error:g}, {own}", own, "ms" if pieces == 1 else "µs", rival, rival,
        pieces=(pieces, pieces), aim=Aim(aim, above=True),
    )  # fmt: skip


def _ends(rounds: int) -> list[Row]:
    """Compare times at equal errors, also with torques that depend on the attitude and on time."""
    rows = []
    for title, end, torque in (("tumbling body", 50.0, 0.0), ("with torques", 10.0, 0.1)):
        functions = {
            name: jax.jit(lambda tolerance, solve=solve, end=end: solve(
                tolerance, _START, _INERTIA, end, diffrax.ForwardMode()
            ))
            for name, (solve, _) in _solvers(unroll=bool(torque), torque=torque).items()
        }  # fmt: skip
        exact = np.asarray(functions["Dopri8"](1e-14))
        rows += [
            _compare(
                f"{title}, to t = {end:g}", functions, exact, rounds, error=error,
                aim=1.0 if torque else aim,
            )
            for error, aim in _AIMS.items()
            if error == 1e-8 or not torque
        ]  # fmt: skip
    return rows


def _gradients(rounds: int) -> Row:
    def gradient(solve: Solve) -> Callable[[float], Any]:
        adjoint = diffrax.RecursiveCheckpointAdjoint(checkpoints=4096)

        def cost(inertia: Any, y0: Any, tolerance: Any) -> Any:
            return solve(tolerance, y0, inertia, 10.0, adjoint)[0]

        both = jax.jit(jax.grad(cost, argnums=(0, 1)))

        def along(tolerance: float) -> Any:
            by_inertia, by_start = both(jnp.asarray(_INERTIA), jnp.asarray(_START), tolerance)
            return np.concatenate([by_inertia, by_start[4:]])

        return along

    functions = {n: gradient(f) for n, (f, _) in _solvers().items() if n != "Tsit5"}
    exact = functions["RKMK8(5,3)"](1e-13)
    return _compare("gradient of an attitude at t = 10", functions, exact, rounds)


def _batches(rounds: int) -> list[Row]:
    inertias = _INERTIA * np.random.default_rng(0).uniform(0.8, 1.2, (_MEMBERS, 3))

    def batch(solve: Solve, derivative: bool) -> Callable[[float], Any]:
        kept = diffrax.RecursiveCheckpointAdjoint(checkpoints=256)

        def end(inertia: Any, tolerance: Any) -> Any:
            adjoint = kept if derivative else diffrax.ForwardMode()
            y = solve(tolerance, _START, inertia, 10.0, adjoint)
            return y[0] if derivative else y

        together = jax.jit(jax.vmap(jax.grad(end) if derivative else end, (0, None)))
        return lambda tolerance: together(inertias, tolerance)

    rows = []
    for title, derivative in (("one", False), ("gradient of one", True)):
        functions = {
            name: batch(f, derivative) for name, (f, _) in _solvers().items() if name != "Tsit5"
        }
        exact = np.asarray(functions["RKMK8(5,3)"](1e-12))
        batch_title = f"{title} of {_MEMBERS} members, to t = 10"
        rows.append(_compare(batch_title, functions, exact, rounds, pieces=_MEMBERS))
    return rows


def _memory() -> list[Row]:
    """Compare the memory that compiled gradients allocate for the steps they keep."""
    solvers = _solvers()

    def megabytes(name: str, adjoint: Any) -> float:
        def end(inertia: Any) -> Any:
            return solvers[name][0](1e-6, _START, inertia, 10.0, adjoint)[0]

        compiled = jax.jit(jax.grad(end)).lower(_INERTIA).compile()
        return float(compiled.memory_analysis().temp_size_in_bytes) / 1e6

    rows = []
    for title, adjoint in (
        (f"{_KEPT} steps kept", diffrax.RecursiveCheckpointAdjoint(checkpoints=_KEPT)),
        ("default adjoint, at most 100000 steps", diffrax.RecursiveCheckpointAdjoint()),
    ):
        here, there = megabytes(_DEFAULT, adjoint), megabytes("Dopri8", adjoint)
        quantity = f"memory of a gradient, {title}, {_DEFAULT}"
        rows.append(Row(quantity, here, "MB", "Dopri8", there, here / there))
    return rows


def _ensembles(rounds: int, quick: bool) -> list[Row]:
    """Compare `jax.vmap` with `cg.solve_ensemble` in compiled code, with the same method."""
    solve, _ = _solvers()[_DEFAULT]
    together = jax.jit(jax.vmap(
        lambda y0: solve(_ERROR, y0, _INERTIA, 10.0, diffrax.ForwardMode())
    ))  # fmt: skip

    def compiled(case: Case, points: Any) -> Any:
        return cg.solve_ensemble(
            case.f, (0.0, 10.0), points, frame=case.frame, method=_DEFAULT,
            rtol=_ERROR, atol=_ERROR, t_eval=[10.0],
        )  # fmt: skip

    rows = []
    with tempfile.TemporaryDirectory() as folder:
        case = tumbling(Path(folder))
        for members in _SIZES[:1] if quick else _SIZES:
            velocities = np.random.default_rng(0).standard_normal((members, 3))
            points = np.concatenate([np.tile(_START[:4], (members, 1)), velocities], axis=1)
            momenta = points * np.concatenate([np.ones(4), _INERTIA])
            vmap = partial(lambda y: np.asarray(together(y)), points)
            calls = {"vmap": vmap, "compiled": partial(compiled, case, momenta)}
            times = measure(calls, rounds=rounds)
            rows.append(times.row(
                f"one of {members} members by vmap, to t = 10, {_DEFAULT}", "vmap", "µs",
                "`cg.solve_ensemble`, `f` in C", "compiled", pieces=(members, members),
            ))  # fmt: skip
    return rows


def _compiling(rounds: int) -> list[Row]:
    unrolled = f"{_DEFAULT}, unroll=True"
    solvers = _solvers()
    solvers[unrolled] = _solvers(unroll=True)[_DEFAULT]
    seconds: dict[str, list[float]] = {_DEFAULT: [], unrolled: [], "Dopri8": []}
    for _ in range(rounds):
        for name, times in seconds.items():
            solve, _ = solvers[name]
            jax.clear_caches()
            begin = time.process_time()
            jax.jit(lambda tolerance, solve=solve: solve(
                tolerance, _START, _INERTIA, 10.0, diffrax.ForwardMode()
            )).lower(1e-6).compile()  # fmt: skip
            times.append(time.process_time() - begin)
    medians = {name: 1e3 * median(times) for name, times in seconds.items()}
    return [
        Row(f"compiling {name}", medians[name], "ms", "Dopri8", medians["Dopri8"],
            medians[name] / medians["Dopri8"],
            aim=Aim(2.0, above=False) if name == _DEFAULT else None)
        for name in (_DEFAULT, unrolled)
    ]  # fmt: skip

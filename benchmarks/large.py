"""Large matrices against SciPy's DOP853 with projection, and rotations with two vectors."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import cg
from cg import frames as fr

from . import projected
from .in_c import field
from .record import Aim, Result, Row
from .timing import measure

_TOLERANCES = {"rtol": 1e-8, "atol": 1e-8}
TITLE = "Large matrices, and rotations with two vectors"

Array = NDArray[np.float64]
Function = Callable[[float, Array], Array]


def method_text(rounds: int) -> str:
    """Return how the times are measured."""
    return (
        "`f` in Python and the default method with tolerances of 1e-8, against SciPy's DOP853 at "
        "the same tolerances on the entries, whose derivative has no coefficients, with projection "
        "after each step. Errors are smaller here. Matrices are random, ends are stored, and BLAS "
        "has one thread. Brockett's flow is y' = [[y, N], y], Toda's [B(y), y], to t = 2; Oja's "
        "y' = (1 - y yᵀ) A y, to t = 5. Rotations with two vectors have rates in C that depend "
        "on time, to t = 50 with steps of 0.01 or tolerances of 1e-8. "
        f"Medians of {rounds} rounds, with quartiles."
    )


def run(quick: bool, figures: Path | None) -> Result:
    """Compare times; smaller ratios are better."""
    rounds = 3 if quick else 15
    problems = _problems(np.random.default_rng(41))
    rows = [_against_dop853(*problem, rounds=rounds) for problem in problems]
    with tempfile.TemporaryDirectory() as folder:
        rows += _motions(Path(folder), rounds)
    return Result(TITLE, method_text(rounds), tuple(rows))


def _problems(rng: np.random.Generator) -> Iterator[tuple[Any, ...]]:
    """Yield name, frame, f, derivative, start and end of each problem, and its aim."""
    normal = rng.standard_normal((20, 20)), rng.standard_normal((50, 50))
    y, matrix = ((x + x.T) / np.sqrt(2.0 * len(x)) for x in normal)
    rates = np.diag(np.arange(1.0, 21.0)) / 20.0
    orbit = fr.IsospectralOrbit.through(y)
    yield "Brockett's flow, n = 20", *_conjugated(orbit, lambda y: y @ rates), y, 2.0, 3.0
    y = np.diag(np.diag(matrix)) + np.diag(np.full(49, 0.7), 1) + np.diag(np.full(49, 0.7), -1)
    orbit = fr.IsospectralOrbit.through(y)
    yield "Toda lattice, n = 50", *_conjugated(orbit, lambda y: np.triu(y, 1)), y, 2.0, 3.0

    def oja(t: float, y: Array) -> Array:
        product = matrix @ y
        return np.asarray(product - y @ (y.T @ product))

    columns, frame = fr.AmbientStiefel(50, 3), fr.Grassmann(50, 3)
    y = columns.random_point(rng)
    yield f"Oja's flow on `{columns!r}`", columns, oja, oja, y, 5.0, 5.0
    yield f"Oja's flow on `{frame!r}`", *_conjugated(frame, matrix.__matmul__), y @ y.T, 5.0, 5.0


def _conjugated(frame: Any, half: Callable[[Array], Array]) -> tuple[Any, Function, Function]:
    """Return y' = [Ω, y] as coefficients and as a derivative, Ω twice the skew part of a matrix."""

    def generator(y: Array) -> Array:
        product = half(y)
        return np.asarray(product - product.T)

    def derivative(t: float, y: Array) -> Array:
        omega = generator(y)
        return omega @ y - y @ omega

    return frame, lambda t, y: frame.group.coefficients(generator(y)), derivative


def _against_dop853(
    name: str, frame: Any, f: Function, derivative: Function, y0: Array, end: float, bound: float,
    *, rounds: int,
) -> Row:  # fmt: skip
    def here(**tolerances: float) -> Array:
        options: dict[str, Any] = {**_TOLERANCES, **tolerances, "t_eval": [end]}
        return np.asarray(cg.solve_ivp(f, (0.0, end), y0, frame=frame, **options).y[-1])

    def there() -> Array:
        points, _ = projected.integrate_entries(derivative, end, y0, frame.project, 1e-8)
        return np.asarray(points[-1])

    exact = here(rtol=1e-13, atol=1e-13)
    if not np.abs(here() - exact).max() <= np.abs(there() - exact).max():
        raise RuntimeError(f"the error here is larger: {name}")
    times = measure({"here": here, "there": there}, rounds=rounds)
    return times.row(
        name, "here", "ms", "DOP853, projected", "there", aim=Aim(bound, above=False), above=False
    )


def _motions(folder: Path, rounds: int) -> list[Row]:
    f = field("motion", folder)
    settings: dict[str, Any] = {"`CF4`": {"method": "CF4", "h": 0.01}, "default": _TOLERANCES}
    frames = fr.Semidirect(fr.SO3(), 2), fr.Product(fr.UnitQuaternion(), fr.Euclidean(6))
    starts = np.eye(5), np.eye(10)[3]
    rows = []
    for name, options in settings.items():
        solve = [
            partial(cg.solve_ivp, f, (0.0, 50.0), y0, frame=frame, t_eval=[50.0], **options)
            for frame, y0 in zip(frames, starts, strict=True)
        ]
        times = measure({"here": solve[0], "there": solve[1]}, rounds=rounds)
        rows.append(
            times.row(
                f"`{frames[0]!r}`, {name}", "here", "ms", "quaternion × R⁶", "there",
                aim=Aim(1.5, above=False), above=False,
            )
        )  # fmt: skip
    return rows

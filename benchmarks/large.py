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

_TOLERANCE = 1e-8
_STEPS: dict[str, Any] = {
    "`CF4`": {"method": "CF4", "h": 0.01}, "default": {"rtol": _TOLERANCE, "atol": _TOLERANCE},
}  # fmt: skip
TITLE = "Large matrices, and rotations with two vectors"

Array = NDArray[np.float64]


def run(quick: bool, figures: Path | None) -> Result:
    """Compare times; smaller ratios are better."""
    rounds = 3 if quick else 15
    problems = _problems(np.random.default_rng(41))
    rows = [_against_dop853(*problem, rounds=rounds) for problem in problems]
    frames = fr.Semidirect(fr.SO3(), 2), fr.Product(fr.UnitQuaternion(), fr.Euclidean(6))
    with tempfile.TemporaryDirectory() as folder:
        f = field("motion", Path(folder))
        for name, options in _STEPS.items():
            rest: dict[str, Any] = {"t_eval": [50.0], **options}
            here, there = (
                partial(cg.solve_ivp, f, (0.0, 50.0), y0, frame=frame, **rest)
                for frame, y0 in zip(frames, (np.eye(5), np.eye(10)[3]), strict=True)
            )
            title = f"`{frames[0]!r}`, {name}"
            rows.append(_row(title, here, "quaternion × R⁶", there, 1.5, rounds))
    method = (
        "`f` in Python and the default method with tolerances of 1e-8, against SciPy's DOP853 at "
        "the same tolerances on the entries, whose derivative has no coefficients, with projection "
        "after each step. Errors are smaller here. Matrices are random, ends are stored, and BLAS "
        "has one thread. Brockett's flow is y' = [[y, N], y], Toda's [B(y), y], to t = 2; Oja's "
        "y' = (1 - y yᵀ) A y, to t = 5. Rotations with two vectors have rates in C that depend on "
        f"time, to t = 50, steps of 0.01 or tolerances of 1e-8. Medians of {rounds} rounds."
    )
    return Result(TITLE, method, tuple(rows))


def _problems(rng: np.random.Generator) -> Iterator[tuple[Any, ...]]:
    """Yield name, frame, half of a generator or None, start and end of each problem, its aim."""
    normal = rng.standard_normal((20, 20)), rng.standard_normal((50, 50))
    y, matrix = ((x + x.T) / np.sqrt(2.0 * len(x)) for x in normal)
    rates = np.diag(np.arange(1.0, 21.0)) / 20.0
    orbit = fr.IsospectralOrbit.through(y)
    yield "Brockett's flow, n = 20", orbit, lambda y: y @ rates, None, y, 2.0, 3.0
    y = np.diag(np.diag(matrix)) + np.diag(np.full(49, 0.7), 1) + np.diag(np.full(49, 0.7), -1)
    orbit = fr.IsospectralOrbit.through(y)
    yield "Toda lattice, n = 50", orbit, lambda y: np.triu(y, 1), None, y, 2.0, 3.0

    def oja(t: float, y: Array) -> Array:
        product = matrix @ y
        return np.asarray(product - y @ (y.T @ product))

    columns, frame = fr.AmbientStiefel(50, 3), fr.Grassmann(50, 3)
    y = columns.random_point(rng)
    yield f"Oja's flow on `{columns!r}`", columns, None, oja, y, 5.0, 5.0
    yield f"Oja's flow on `{frame!r}`", frame, matrix.__matmul__, None, y @ y.T, 5.0, 5.0


def _against_dop853(
    name: str, frame: Any, half: Any, given: Any, y0: Array, end: float, bound: float,
    *, rounds: int,
) -> Row:  # fmt: skip
    def generator(y: Array) -> Array:
        product = half(y)
        return np.asarray(product - product.T)

    def commutator(t: float, y: Array) -> Array:
        omega = generator(y)
        return omega @ y - y @ omega

    def here(tolerance: float = _TOLERANCE) -> Array:
        f = given or (lambda t, y: frame.group.coefficients(generator(y)))
        options: dict[str, Any] = {"rtol": tolerance, "atol": tolerance, "t_eval": [end]}
        return np.asarray(cg.solve_ivp(f, (0.0, end), y0, frame=frame, **options).y[-1])

    def there() -> Array:
        f = given or commutator
        return projected.integrate_entries(f, end, y0, frame.project, _TOLERANCE)[0][-1]  # type: ignore[no-any-return]

    exact = here(1e-13)
    if not np.abs(here() - exact).max() <= np.abs(there() - exact).max():
        raise RuntimeError(f"the error here is larger: {name}")
    return _row(name, here, "DOP853, projected", there, bound, rounds)


def _row(
    name: str, here: Callable[[], object], against: str, there: Callable[[], object], bound: float,
    rounds: int,
) -> Row:  # fmt: skip
    times = measure({"here": here, "there": there}, rounds=rounds)
    aim = Aim(bound, above=False)
    return times.row(name, "here", "ms", against, "there", aim=aim, above=False)

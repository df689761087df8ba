"""Cost of derivatives: by one parameter, by all parameters, and by the point as well."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

import cg

from .cases import Array
from .record import Result
from .timing import measure

TITLE = "Cost of derivatives"
_FRAME = cg.frames.Product(cg.frames.SO3(), cg.frames.Euclidean(3))
_WORK = 200  # square roots that `f` takes in addition where it is costly

DIRECTIONS = {"one parameter": np.eye(9)[:, 6:7], "three parameters": "parameters", "all": None}
"""Values of ``derivatives_by``, with 1, 3 and 9 derivatives."""


def run(quick: bool) -> Result:
    """Measure integrations with derivatives, as ratios to those without."""
    rounds = 3 if quick else 15
    y0 = _FRAME.join(np.eye(3), np.array([1.0, 2.0, -0.5]))
    rows = []
    for kind, f in {"cheap": _body, "costly": _costly}.items():
        solve = partial(
            cg.solve_ivp, f, (0, 5), y0, frame=_FRAME, parameters=[1.0, 2.0, 2.5], rtol=1e-6,
            atol=1e-6,
        )  # fmt: skip
        contestants: dict[str, Callable[[], object]] = {"plain": solve}
        for name, by in DIRECTIONS.items():
            contestants[name] = partial(solve, derivatives="forward", derivatives_by=by)
        times = measure(contestants, rounds=rounds)
        rows += [
            times.row(f"{kind} `f`, {name}", name, "ms", "the integration alone", "plain")
            for name in DIRECTIONS
        ]
    text = (
        'A rigid body on SO(3) × R³ with `derivatives="forward"`, `f` in Python without `jac`, so '
        "that derivatives of `f` are differences, and tolerances of 1e-6: by one moment of "
        "inertia, by three, and by these and the point. A costly `f` takes "
        f"{_WORK} square roots in addition. Medians of {rounds} rounds."
    )
    return Result(TITLE, text, tuple(rows))


def _body(t: float, y: Array, inertia: Array) -> list[float]:
    (i1, i2, i3), (a, b, c) = inertia.tolist(), y[9:].tolist()
    return [a, b, c, (i2 - i3) * b * c / i1, (i3 - i1) * c * a / i2, (i1 - i2) * a * b / i3]


def _costly(t: float, y: Array, inertia: Array) -> Any:
    for k in range(_WORK):
        k**0.5
    return _body(t, y, inertia)

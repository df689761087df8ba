"""Ensembles of rigid bodies: the cost of output, events and functions in Python per member."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import cg
from cg.frames import Euclidean, Product, UnitQuaternion

from .in_c import field
from .record import Aim, Result, Row
from .timing import Times, measure

_FRAME = Product(UnitQuaternion(), Euclidean(3))
_INVERSE = np.array([1.0, 0.5, 0.4])
_END = 10.0
_TOLERANCE = 1e-6
_OUTPUT = {101: Aim(2.0, above=False), 1001: None}
_EVENT_AIM = Aim(0.5, above=False, of="value")

TITLE = "Ensembles"

Array = NDArray[np.float64]


def method_text(rounds: int) -> str:
    """Return how ensembles are measured."""
    return (
        "Free rigid bodies with random attitudes and momenta, a quaternion × R³, to "
        f"t = {_END:g} with the default method, tolerances {_TOLERANCE:g}, one core; `f` in C "
        "unless another is named. The event is that an axis of the body becomes horizontal; all "
        f"events are stored. Medians of {rounds} rounds. For output and events the ratio is the "
        "time here divided by the time there."
    )


def run(quick: bool, figures: Path | None) -> Result:
    """Compare ensembles with the same with less output, and with a loop in Python."""
    rounds, members, few = (2, 100, 10) if quick else (9, 1000, 100)
    many = _FRAME.random_point(np.random.default_rng(1), (members,))
    settings: dict[str, Any] = {"frame": _FRAME, "rtol": _TOLERANCE, "atol": _TOLERANCE}
    with tempfile.TemporaryDirectory() as folder:
        f, event = field("free_body", Path(folder), _INVERSE), field("level", Path(folder))

        def solve(f: Any, y0: Array, count: int = 2, **options: Any) -> None:
            times = np.linspace(0.0, _END, count)
            cg.solve_ensemble(f, (0.0, _END), y0, t_eval=times, **settings, **options)

        def alone() -> None:
            for point in many[:few]:
                cg.solve_ivp(f, (0.0, _END), point, t_eval=[0.0, _END], **settings)

        contestants: dict[str, Callable[[], None]] = {
            f"{count} times": partial(solve, f, many, count) for count in (2, *_OUTPUT)
        }
        contestants |= {
            "f in C": partial(solve, f, many[:few]),
            "event in C": partial(solve, f, many[:few], events=event),
            "event in Python": partial(solve, f, many[:few], events=level),
            "NumPy": partial(solve, fields, many, vectorized=True),
            "alone": alone,
        }
        times = measure(contestants, rounds=rounds, seconds=0.2)
    return Result(TITLE, method_text(rounds), tuple(_rows(times, members, few)))


def _rows(times: Times, members: int, few: int) -> list[Row]:
    """Return times of each member, compared with less output and with a loop in Python."""
    rows = [
        times.row(
            f"{members} members, {count} output times", f"{count} times", "ms per member",
            "2 output times", "2 times", pieces=(members, members), aim=aim, above=False,
        )
        for count, aim in _OUTPUT.items()
    ]  # fmt: skip
    rows += [
        times.row(
            f"{few} members, an {name}", name, "ms per member", "no event", "f in C",
            pieces=(few, few), aim=aim, above=False,
        )
        for name, aim in (("event in C", _EVENT_AIM), ("event in Python", None))
    ]  # fmt: skip
    return rows + [
        times.row(
            f"{members} members, `f` in {what}", name, "ms per member",
            "`solve_ivp` for each, `f` in C", "alone", pieces=(members, few),
        )
        for what, name in (("C", "2 times"), ("NumPy, vectorized", "NumPy"))
    ]  # fmt: skip


def fields(t: Array, y: Array) -> Array:
    """Return the coefficients of many bodies, shape ``(k, 6)``."""
    m = y[:, 4:]
    velocity = _INVERSE * m
    return np.concatenate([velocity, np.cross(m, velocity)], axis=-1)


def level(t: float, y: Array) -> float:
    """Return the vertical part of an axis, as ``level`` of ``fields.c`` does."""
    x, z, v, s = y[:4].tolist()
    return float(s * s + v * v - x * x - z * z)

"""Ensembles of rigid bodies: the cost of output, events and functions in Python per member."""

from __future__ import annotations

import importlib.util
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
_OUTPUT = {101: Aim(1.8, above=False), 1001: Aim(6.0, above=False)}
_RK4_MEMBERS, _RK4_TIMES = 2000, 201
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
        "time here divided by the time there. numba's loop takes classical Runge-Kutta steps on "
        "the seven numbers, divides the quaternion by its length after each, and takes as few "
        "between output times as make its largest error no larger than the one here."
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
        rows = _rows(times, members, few)
        if importlib.util.find_spec("numba") is not None:
            rows.append(_beside_rk4(f, few if quick else _RK4_MEMBERS, rounds, settings))
    return Result(TITLE, method_text(rounds), tuple(rows))


def _beside_rk4(f: Any, members: int, rounds: int, settings: dict[str, Any]) -> Row:
    """Compare outputs with those of classical Runge-Kutta steps by numba, at equal errors."""
    import numba

    y0, times = _FRAME.random_point(np.random.default_rng(2), (members,)), _RK4_TIMES
    t = np.linspace(0.0, _END, times)
    rk4: Any = partial(numba.njit(_rk4), numba.njit(_rates))

    def here(**options: Any) -> Any:
        return cg.solve_ensemble(f, (0.0, _END), y0, t_eval=t, **{**settings, **options}).y

    exact = here(rtol=1e-12, atol=1e-12)
    error, steps = np.abs(here() - exact).max(), 1
    while np.abs(rk4(y0, times, steps, _END / (times - 1) / steps) - exact).max() > error:
        steps += 1
    h = _END / (times - 1) / steps
    compared = measure(
        {"here": here, "numba": lambda: rk4(y0, times, steps, h)},
        rounds=rounds, seconds=0.2,
    )  # fmt: skip
    return compared.row(
        f"{members} members, {times} output times, error {error:.0e}", "here", "ms per member",
        f"numba, RK4, {steps} steps between outputs", "numba", pieces=(members, members),
        aim=Aim(1.0, above=False), above=False,
    )  # fmt: skip


def _rk4(rates: Any, y0: Array, times: int, steps: int, h: float) -> Array:
    """Return bodies at equally spaced times, shape ``(times, members, 7)``."""
    out, k, z = np.empty((times, len(y0), 7)), np.zeros((5, 7)), np.empty(7)
    for member in range(len(y0)):
        out[0, member] = y0[member]
        y = y0[member].copy()
        for step in range((times - 1) * steps):
            for i in range(4):
                for n in range(7):
                    z[n] = y[n] + h * (0.0, 0.5, 0.5, 1.0)[i] * k[i, n]
                rates(z, k[i + 1])
            for n in range(7):
                y[n] += h / 6 * (k[1, n] + 2 * k[2, n] + 2 * k[3, n] + k[4, n])
            length = (y[0] ** 2 + y[1] ** 2 + y[2] ** 2 + y[3] ** 2) ** 0.5
            for n in range(4):
                y[n] /= length
            if (step + 1) % steps == 0:
                out[(step + 1) // steps, member] = y
    return out


def _rates(y: Array, rates: Array) -> None:
    """Write the derivatives of a body's quaternion and momentum."""
    i, j, k, w, x, y_, z = y
    a, b, c = _INVERSE[0] * x, _INVERSE[1] * y_, _INVERSE[2] * z
    rates[0], rates[1] = (w * a + j * c - k * b) / 2, (w * b + k * a - i * c) / 2
    rates[2], rates[3] = (w * c + i * b - j * a) / 2, -(i * a + j * b + k * c) / 2
    rates[4], rates[5], rates[6] = y_ * c - z * b, z * a - x * c, x * b - y_ * a


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

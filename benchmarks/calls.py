"""Overhead of calls: a short integration, and one sample of a control loop."""

from __future__ import annotations

from functools import partial
from itertools import chain
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

import cg
from cg.frames import SO3, Euclidean, Product

from .in_c import field
from .record import Aim, Result, Row
from .timing import Times, measure

_FRAME = Product(SO3(), Euclidean(3))
_SPAN = (0.0, 1e-6)
_SAMPLE = 0.1
_SAMPLES = 100
_INERTIA = (1.0, 2.0, 2.5)
TITLE = "Overhead of calls"

Array = NDArray[np.float64]


def method_text(rounds: int) -> str:
    """Return how the calls are measured."""
    return (
        "A rigid body on SO(3) × R³ with default arguments and `f` in Python. A control loop with "
        f"{_SAMPLES} samples holds the torque during each sample; the time is that of a sample "
        f"less its calls of `f`. Medians of {rounds} rounds."
    )


def run(quick: bool, figures: Path | None) -> Result:
    """Measure a short integration and a sample."""
    rounds = 3 if quick else 31
    y0 = _FRAME.join(np.eye(3), np.array([1.0, 2.0, -0.5]))
    coefficients, numbers = np.linspace(0.1, 0.6, 6), np.ones(12)
    stepper = cg.Stepper(_body, 0.0, y0, frame=_FRAME, method="CF4", h=_SAMPLE, args=(np.zeros(3),))
    torques = np.random.default_rng(1).standard_normal((_SAMPLES, 3))

    def samples() -> None:
        stepper.restart(t=0.0, y=y0)
        for k, torque in enumerate(torques, 1):
            stepper.restart(args=(torque,))
            stepper.advance(_SAMPLE * k)

    before = stepper.nfev
    samples()
    evaluations = stepper.nfev - before

    def fields() -> None:
        torque = torques[0]
        for _ in range(evaluations):
            _body(0.0, y0, torque)

    times = measure(
        {
            "here": lambda: cg.solve_ivp(lambda t, y: coefficients, _SPAN, y0, frame=_FRAME),
            "SciPy": lambda: solve_ivp(lambda t, y: numbers, _SPAN, numbers, method="DOP853"),
            "samples": samples,
            "fields": fields,
        },
        rounds=rounds,
    )
    rows = _in_python(times, evaluations), _compiled(y0, rounds)
    return Result(TITLE, method_text(rounds), tuple(chain(*rows)))


def _in_python(times: Times, evaluations: int) -> tuple[Row, ...]:
    """Return the rows of a short integration, and of a sample less its calls of ``f``."""
    both = zip(times.rounds["samples"], times.rounds["fields"], strict=True)
    return (
        times.row(
            "`solve_ivp` from 0 to 1e-6, constant `f`", "here", "µs",
            "SciPy's `solve_ivp` with DOP853, 12 entries", "SciPy",
            aim=Aim(0.8, above=False), above=False,
        ),
        Row(
            "a sample: `Stepper.restart(args=)`, `advance`, one step of `CF4`, without its "
            f"{evaluations / _SAMPLES:g} calls of `f`",
            1e6 * median(a - b for a, b in both) / _SAMPLES,
            "µs",
            "the calls of `f` alone, in Python",
            1e6 * times.median("fields") / _SAMPLES,
            aim=Aim(20.0, above=False, of="value"),
        ),
    )  # fmt: skip


def _compiled(y0: Array, rounds: int) -> tuple[Row, ...]:
    """Measure samples of a heavy top in C, whose data are replaced, and of RK4 in NumPy."""
    data, h = np.array([[0.5, 0.6, 0.7, 1.0]]), 1e-3

    def step(stepper: cg.Stepper, parameters: bool) -> None:
        changed: Any = (
            {"parameters": data[0]} if parameters else {"inputs": cg.Samples([0.0], data)}
        )
        stepper.restart(**changed)
        stepper.step()

    def numpy() -> None:
        k1 = _top(y0, data[0])
        k2 = _top(y0 + h / 2 * k1, data[0])
        k3 = _top(y0 + h / 2 * k2, data[0])
        y0 + h / 6 * (k1 + 2 * k2 + 2 * k3 + _top(y0 + h * k3, data[0]))

    with TemporaryDirectory() as folder:
        given: Any = {
            "f": field("heavy_top", Path(folder)),
            "frame": _FRAME,
            "method": "CF4",
            "h": h,
        }
        one = cg.Stepper(t0=0.0, y0=y0, parameters=data[0], **given)
        other = cg.Stepper(t0=0.0, y0=y0, inputs=cg.Samples([0.0], data), **given)
        names = {"parameters": partial(step, one, True), "inputs": partial(step, other, False)}
        times = measure(names | {"numpy": numpy}, rounds=rounds)
    what, aim = "with `f` in C: `Stepper.restart({}=)`, one step of `CF4`", Aim(1.0, above=False)
    there = "µs", "RK4 in NumPy", "numpy"
    return tuple(times.row(what.format(x), x, *there, aim=aim, above=False) for x in names)


def _top(y: Array, data: Array) -> Array:
    attitude, (a, b, c) = y[:9].reshape(3, 3), data[:3] * y[9:]
    turned = attitude @ [[0.0, -c, b], [c, 0.0, -a], [-b, a, 0.0]]
    torque = np.cross(y[9:], (a, b, c)) + data[3] * np.array([y[7], -y[6], 0.0])
    return np.concatenate([turned.ravel(), torque])


def _body(t: float, y: Array, torque: Array) -> list[float]:
    (i1, i2, i3), (a, b, c) = _INERTIA, torque.tolist()
    w1, w2, w3 = y[9:].tolist()
    return [
        w1,
        w2,
        w3,
        ((i2 - i3) * w2 * w3 + a) / i1,
        ((i3 - i1) * w3 * w1 + b) / i2,
        ((i1 - i2) * w1 * w2 + c) / i3,
    ]

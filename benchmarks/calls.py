"""Overhead of calls: a short integration, and one sample of a control loop."""

from __future__ import annotations

from statistics import median

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

import cg
from cg.frames import SO3, Euclidean, Product

from .record import Result, Row
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


def run(quick: bool) -> Result:
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
    return Result(TITLE, method_text(rounds), _rows(times, evaluations))


def _rows(times: Times, evaluations: int) -> tuple[Row, ...]:
    """Return the rows of a short integration, and of a sample less its calls of ``f``."""
    both = zip(times.rounds["samples"], times.rounds["fields"], strict=True)
    return (
        times.row(
            "`solve_ivp` from 0 to 1e-6, constant `f`", "here", "µs",
            "SciPy's `solve_ivp` with DOP853, 12 entries", "SciPy",
        ),
        Row(
            "a sample: `Stepper.restart(args=)`, `advance`, one step of `CF4`, without its "
            f"{evaluations / _SAMPLES:g} calls of `f`",
            1e6 * median(a - b for a, b in both) / _SAMPLES,
            "µs",
            "the calls of `f` alone, in Python",
            1e6 * times.median("fields") / _SAMPLES,
        ),
    )  # fmt: skip


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

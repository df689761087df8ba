"""What calls cost beside f: a short integration, a sample of a control loop; and lines of code."""

from __future__ import annotations

from pathlib import Path
from statistics import median

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

import cg
from cg.frames import SO3, Euclidean, Product

from .record import Aim, Result, Row
from .timing import measure

_FRAME = Product(SO3(), Euclidean(3))
_SPAN = (0.0, 1e-6)
_SAMPLE = 0.1
_SAMPLES = 100
_INERTIA = (1.0, 2.0, 2.5)
_ROOT = Path(cg.__file__).parent.parent
_FOLDERS = (Path("cg", "integration"), Path("fortran"))

Array = NDArray[np.float64]


def run(quick: bool, figures: Path | None) -> Result:
    """Measure a call and a sample, and count lines."""
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
    both = zip(times.rounds["samples"], times.rounds["fields"], strict=True)
    rows = (
        times.row(
            "`solve_ivp` from 0 to 1e-6, f returns a constant", "here", "µs",
            "SciPy's `solve_ivp`, DOP853, twelve numbers", "SciPy",
            aim=Aim(1.0, above=False), above=False,
        ),
        Row(
            f"a sample of {_SAMPLE:g} s: `Stepper.restart(args=)`, `advance`, one step of `CF4`, "
            f"beside its {evaluations / _SAMPLES:g} calls of f",
            1e6 * median(a - b for a, b in both) / _SAMPLES,
            "µs",
            "the calls of f alone, in Python",
            1e6 * times.median("fields") / _SAMPLES,
            aim=Aim(20.0, above=False, of="value"),
        ),
        Row(
            f"`{_FOLDERS[0].as_posix()}` and `{_FOLDERS[1].as_posix()}`",
            count_lines(_ROOT),
            "lines",
            aim=Aim(12_200, above=False, of="value"),
        ),
    )  # fmt: skip
    return Result(
        "Calls, samples and lines",
        "SO(3) × R³, defaults where nothing is said, f in Python. The torque on a rigid body is "
        f"held for a sample, and there are {_SAMPLES} of them. Lines are those of all files, "
        f"comments and blank ones among them. Medians of {rounds} rounds.",
        rows,
    )


def count_lines(root: Path) -> int:
    """Return the number of lines of the integrator, in Python, Fortran and C."""
    files = (file for folder in _FOLDERS for file in (root / folder).rglob("*") if file.is_file())
    return sum(
        file.read_bytes().count(b"\n") for file in files if file.parent.name != "__pycache__"
    )


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

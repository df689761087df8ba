"""The time of compiled steps compared with the sum of the times of their parts."""

from __future__ import annotations

import tempfile
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np
from numpy.typing import NDArray

import cg
from cg.catalogue import resolve_method
from cg.frames import SE3, SO3, SU, Euclidean, Frame, Product, UnitQuaternion
from cg.integration.rhs.compiled import compiled_rhs
from cg.integration.step.blocks import block_constants, describe_blocks
from cg.integration.step.paths import paths_of

from .compiled import field
from .record import Aim, Result, Row
from .timing import measure

_FRAMES: dict[str, Frame] = {
    "SO(3)": SO3(),
    "SO(3) × R³": Product(SO3(), Euclidean(3)),
    "SE(3)": SE3(),
    "quaternion × R³": Product(UnitQuaternion(), Euclidean(3)),
    "SU(3)": SU(3),
}
_METHODS = ("CF4", "RKMK4", "RKMK8(5,3)")
_H = 0.01
_STEPS = 20_000
_COUNT = 256  # points at a time, which stay in the cache

TITLE = "Compiled steps and their parts"


def method_text(rounds: int) -> str:
    """Return how steps and parts are measured."""
    return (
        f"{_STEPS} steps of h = {_H:g} with a trivial function in C, storing the last point, "
        "compared with the sum of the flows of a step, the removal of rounding errors from its "
        f"result, its evaluations and its dexp⁻¹, each measured separately on {_COUNT} points; "
        f"linear combinations of coefficients count as parts of flows. Medians of {rounds} rounds "
        "in turns."
    )


def run(quick: bool, figures: Path | None) -> Result:
    """Measure steps and their parts in the same run."""
    rounds = 2 if quick else 11
    rows: list[Row] = []
    with tempfile.TemporaryDirectory() as folder:
        frames = dict(list(_FRAMES.items())[:2]) if quick else _FRAMES
        for label, frame in frames.items():
            for name in _METHODS:
                f = field("linear", Path(folder), [frame.dim])
                rows.append(_row(label, frame, name, f, rounds))
    return Result(TITLE, method_text(rounds), tuple(rows))


def _row(label: str, frame: Frame, name: str, f: Any, rounds: int) -> Row:
    method = resolve_method(name)
    paths = paths_of(method)
    rng = np.random.default_rng(1)
    y0 = frame.random_point(rng)

    def steps() -> None:
        cg.integrate(f, (0.0, _STEPS * _H), y0, frame=frame, method=method, h=_H, save_every=_STEPS)

    parts = _parts(frame, f, y0, max(paths.series, 1), rng)
    lengths = Counter(len(path.flows) for path in paths.paths)
    contestants: dict[str, Callable[[], object]] = {"step": steps}
    contestants |= {f"flows {k}": parts[0](k, False) for k in lengths}
    last = len(paths.paths[paths.result - 1].flows)
    contestants |= {"result": parts[0](last, True), "evaluation": parts[1]}
    if paths.series:
        contestants["dexpinv"] = parts[2]
    times = measure(contestants, rounds=rounds, seconds=0.05)

    evaluations = len(paths.stages) - (paths.final_stage > 0)

    def total(k: int) -> float:
        each = {key: times.rounds[key][k] / _COUNT for key in contestants if key != "step"}
        flows = sum(count * each[f"flows {n}"] for n, count in lengths.items())
        restored = each["result"] - each[f"flows {last}"]
        inverse = sum(path > 0 for path in paths.stages) * each.get("dexpinv", 0.0)
        return flows + restored + inverse + evaluations * each["evaluation"]

    sums = [total(k) for k in range(rounds)]
    whole = [seconds / _STEPS for seconds in times.rounds["step"]]
    return Row(
        f"a step of `{name}` on {label}",
        1e6 * median(whole),
        "µs",
        "sum of the parts",
        1e6 * median(sums),
        median(a / b for a, b in zip(whole, sums, strict=True)),
        aim=Aim(1.2, above=False),
    )


def _parts(
    frame: Frame, f: Any, y0: NDArray[Any], order: int, rng: np.random.Generator
) -> tuple[Callable[[int, bool], Callable[[], object]], Callable[[], object], Callable[[], object]]:
    """Return functions that compute flows, evaluations and dexp⁻¹ of `_COUNT` points."""
    import cg._core_r64 as core

    blocks, constants = describe_blocks(frame), block_constants(frame)
    points = np.repeat(y0[None], _COUNT, axis=0)
    flat = points.reshape(-1).view(np.float64)
    u = 0.3 * _H * rng.standard_normal(_COUNT * frame.dim)
    v = np.ones_like(u)

    def flows(count: int, restoring: bool) -> Callable[[], object]:
        fields = 0.3 * _H * rng.standard_normal(_COUNT * count * frame.dim)
        # away and back again, or rounding would add up over the calls
        away = [np.ascontiguousarray(s * fields) for s in (1.0, -1.0)]
        turn = [0]

        def call() -> None:
            turn[0] = 1 - turn[0]
            core.frame_move(blocks, constants, count, away[turn[0]], restoring, flat)

        return call

    rhs = compiled_rhs(f)
    assert rhs is not None
    addresses = rhs.on(frame, None).addresses()
    rows, coefficients = flat.reshape(_COUNT, -1), np.empty((_COUNT, frame.dim))
    return (
        flows,
        lambda: core.call_field(*addresses, 0.0, rows.T, coefficients.T),
        lambda: core.frame_dexpinv(blocks, order, u, v.copy()),
    )

"""Many tops on JAX's device, with fixed and chosen steps, in double and single precision.

``python -m benchmarks.accelerator [--members N] [--json FILE]``.  Where the device is no CPU, the
same is measured on the CPU, with fewer members if memory is short.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np

import cg

_END = 1.0
_H = 0.01
_ARM = (0.0, 0.0, 1.0)  # weight times the centre of mass, in body axes
_METHODS = {"fixed": "CF4", "chosen": "RKMK5(4)"}
_TOLERANCES = {"float64": 1e-8, "float32": 1e-5}
_MAX_STEPS = 4096


def _tops(members: int, dtype: Any) -> tuple[Any, Any]:
    """Return starts and moments of inertia, shapes ``(members, 7)`` and ``(members, 3)``."""
    rng = np.random.default_rng(0)
    quaternions = rng.standard_normal((members, 4))
    quaternions /= np.linalg.norm(quaternions, axis=1, keepdims=True)
    velocities = rng.standard_normal((members, 3)) + np.array([0.0, 0.0, 5.0])
    inertias = np.array([1.0, 1.0, 0.5]) * rng.uniform(0.8, 1.2, (members, 3))
    points = np.concatenate([quaternions, velocities], axis=1)
    return points.astype(dtype), inertias.astype(dtype)


def _runner(steps: str, dtype: Any) -> Callable[[Any, Any], Any]:
    """Return a function of a start and moments of inertia: the end, and the number of steps."""
    import diffrax
    import jax.numpy as jnp

    frame = cg.frames.Product(cg.frames.UnitQuaternion(), cg.frames.Euclidean(3))

    def coefficients(t: Any, y: Any, inertia: Any) -> Any:
        quaternion, velocity = cg.jax.split(frame, y)
        i, j, k, w = quaternion
        down = -jnp.stack(
            [2.0 * (i * k - w * j), 2.0 * (j * k + w * i), 1.0 - 2.0 * (i * i + j * j)]
        )
        torque = jnp.cross(jnp.asarray(_ARM, dtype), down)
        turning = jnp.cross(inertia * velocity, velocity)
        return jnp.concatenate([velocity, (turning + torque) / inertia])

    tolerance = _TOLERANCES[np.dtype(dtype).name]
    chosen = steps == "chosen"
    control = cg.jax.controller(frame, tolerance, tolerance)
    term = cg.jax.FrameTerm(coefficients, frame)
    solver = cg.jax.Solver(_METHODS[steps], dense="steps")

    def member(start: Any, inertia: Any) -> Any:
        solution = diffrax.diffeqsolve(
            term,
            solver,
            jnp.zeros((), dtype),
            jnp.asarray(_END, dtype),
            None if chosen else jnp.asarray(_H, dtype),
            start,
            inertia,
            stepsize_controller=control if chosen else diffrax.ConstantStepSize(),
            max_steps=_MAX_STEPS,
            adjoint=diffrax.ForwardMode(),
        )
        return solution.ys[-1], solution.stats["num_steps"]

    return member


def measure(device: Any, members: int, steps: str, dtype: Any, rounds: int) -> dict[str, Any]:
    """Return the times of compiling and of all members, and the largest drift from the manifold.

    Parameters
    ----------
    device
        A device of JAX.
    members
        Number of tops.
    steps
        ``"fixed"`` or ``"chosen"``.
    dtype
        ``numpy.float64`` or ``numpy.float32``.
    rounds
        Number of runs, of whose times the median counts.
    """
    import jax

    with jax.default_device(device):
        batch = [jax.device_put(part, device) for part in _tops(members, dtype)]
        begin = time.perf_counter()
        run = jax.jit(jax.vmap(_runner(steps, dtype))).lower(*batch).compile()
        compiling = time.perf_counter() - begin
        seconds = []
        for _ in range(rounds + 1):
            begin = time.perf_counter()
            ends, counts = jax.block_until_ready(run(*batch))
            seconds.append(time.perf_counter() - begin)
    lengths = np.linalg.norm(np.asarray(ends, np.float64)[:, :4], axis=1)
    total = median(seconds[1:])
    return {
        "device": f"{device.platform}: {device.device_kind}",
        "members": members,
        "steps": steps,
        "method": _METHODS[steps],
        "precision": np.dtype(dtype).name,
        "tolerance": _TOLERANCES[np.dtype(dtype).name] if steps == "chosen" else None,
        "mean_steps": float(np.mean(counts)),
        "compile_s": compiling,
        "run_s": total,
        "steps_per_s": float(np.sum(counts)) / total,
        "drift": float(np.abs(lengths - 1.0).max()),
    }


def _table(rows: list[dict[str, Any]]) -> str:
    lines = [
        "| device | members | steps | precision | compile | run | steps/s | CPU = 1 | drift |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    for row in rows:
        ratio = row.get("against_cpu")
        against = "" if ratio is None else f"{ratio:.1f}"
        lines.append(
            f"| {row['device']} | {row['members']} | {row['steps']}, {row['method']} "
            f"| {row['precision']} | {row['compile_s']:.2f} s | {row['run_s']:.4g} s "
            f"| {row['steps_per_s']:.3g} | {against} | {row['drift']:.1e} |"
        )
    return "\n".join(lines)


def main(arguments: list[str] | None = None) -> int:
    """Measure what the command line asks for, print a table and write JSON."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.accelerator", description=(__doc__ or "").splitlines()[0]
    )
    parser.add_argument("--members", type=int, default=1_000_000)
    parser.add_argument(
        "--cpu-members", type=int, help="members on the CPU beside an accelerator; by default all"
    )
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--json", type=Path, help="a file for the numbers")
    parsed = parser.parse_args(arguments)
    import jax

    jax.config.update("jax_enable_x64", True)
    sizes = {jax.devices()[0]: parsed.members}
    sizes.setdefault(jax.devices("cpu")[0], parsed.cpu_members or parsed.members)
    rows: list[dict[str, Any]] = []
    for steps in _METHODS:
        for dtype in (np.float64, np.float32):
            actual = [
                measure(device, members, steps, dtype, parsed.rounds)
                for device, members in sizes.items()
            ]
            if len(actual) > 1:
                actual[0]["against_cpu"] = actual[0]["steps_per_s"] / actual[1]["steps_per_s"]
            rows.extend(actual)
    print(_table(rows))
    if parsed.json is not None:
        parsed.json.write_text(json.dumps(rows, indent=2) + "\n", encoding="utf-8")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())

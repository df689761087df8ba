"""Calls of frames and problems that work, for `test_fuzz_arguments.py`."""

import contextlib
import inspect

import numpy as np
from argument_examples import RNG, SO3, Call, by_name, call
from frame_examples import HEISENBERG

from cg import frames, problems
from cg.frames import FlowOverflowError

FRAMES = {
    "SO3": SO3, "SO": frames.SO(4), "U": frames.U(2), "SU": frames.SU(2), "GL": frames.GL(2),
    "SL": frames.SL(2), "Sp": frames.Sp(2), "SE3": frames.SE3(),
    "Semidirect": frames.Semidirect(frames.SO(2), 2), "Sphere": frames.Sphere(2),
    "Stiefel": frames.Stiefel(3, 2),
    "Grassmann": frames.Grassmann(3, 2), "Hyperbolic": frames.Hyperbolic(2), "SPD": frames.SPD(2),
    "UnitQuaternion": frames.UnitQuaternion(), "Euclidean": frames.Euclidean(3),
    "IsospectralOrbit": frames.IsospectralOrbit((-1.0, 0.25, 1.5)),
    "CoadjointOrbit": frames.CoadjointOrbit(SO3, (0.6, 0.0, -0.8)),
    "Product": frames.Product(frames.Sphere(2), frames.Euclidean(2)),
    "Power": frames.Power(frames.Sphere(2), 2), "PhaseSpace": frames.PhaseSpace(frames.Sphere(2)),
    "FieldFrame": HEISENBERG,
    "MatrixFrame": frames.MatrixFrame([[[0.0, 1.0], [0.0, 0.0]], [[1.0, 0.0], [0.0, -1.0]]]),
}  # fmt: skip


def of_frame(name, frame):
    """Return calls of the methods of a frame."""
    y = np.zeros(frame.point_shape, frame.dtype)
    with contextlib.suppress(NotImplementedError):
        y = frame.random_point(np.random.default_rng(2))
    v = 0.1 * np.arange(1.0, frame.dim + 1)
    near = frame.flow(v, y)
    arguments = {
        "field": {"v": v, "y": y}, "flow": {"v": v, "y": y}, "without_isotropy": {"v": v, "y": y},
        "membership_error": {"y": y}, "relative_error": {"y": y}, "project": {"y": y},
        "random_point": {"rng": RNG, "size": (2,)}, "random_vector": {"rng": RNG, "size": (2,)},
        "distance": {"x": y, "y": near}, "exp_coordinates": {"y0": y, "y1": near},
        "local_coordinates": {"y0": y, "y1": near}, "coordinate_sizes": {"y": y},
        "check_point": {"y": y, "tolerance": 1e-8, "name": "y"}, "bracket": {"u": v, "v": 2 * v},
        "dexpinv": {"u": v, "v": v[::-1], "order": 4}, "algebra": {"v": v}, "exponential": {"v": v},
        "inverse": {"x": near}, "coefficients": {"y": y, "dy": frame.field(v, y)},
    }  # fmt: skip
    if name == "FieldFrame":  # there is no bracket
        del arguments["bracket"], arguments["dexpinv"]
    for method, values in arguments.items():
        if callable(getattr(frame, method, None)):
            yield (
                f"{name}.{method}",
                Call(getattr(frame, method), values, (FlowOverflowError, NotImplementedError)),
            )


GROUPS = [frames.GL, frames.SL, frames.SO, frames.SU, frames.U, frames.Sp]
_COLUMNS = frames.Stiefel, frames.Grassmann
FRAME_EXAMPLES = by_name([
    *(call(group, n=2, convention="space") for group in GROUPS),
    *(call(group, convention="space") for group in (frames.SO3, frames.SE3)),
    call(frames.UnitQuaternion, convention="space", scalar_first=True),
    *(call(space, n=2) for space in (frames.Sphere, frames.Euclidean, frames.SPD)),
    *(call(space, n=3, k=2) for space in _COLUMNS),
    call(frames.Hyperbolic, n=3),
    call(frames.IsospectralOrbit, spectrum=(0.0, 1.0)),
    call(frames.IsospectralOrbit.through, y0=[[1.0, 0.5], [0.5, 2.0]]),
    call(frames.CoadjointOrbit, algebra=SO3, point=(0.6, 0.0, 0.8)),
    call(frames.Power, factor=SO3, n=2),
    call(frames.PhaseSpace, frame=SO3, inertia=[1.0, 2.0, 2.5]),
    *(
        call(getattr(FRAMES["PhaseSpace"], name), y=np.array([0.6, 0.0, 0.8, 0.3, 0.5, 0.2]))
        for name in ("split", "velocity", "kinetic_energy")
    ),
    call(lambda factor: frames.Product(SO3, factor), factor=SO3),
    call(FRAMES["Product"].split, y=np.zeros(5)),
    call(frames.Semidirect, group=SO3, copies=2),
    call(frames.LinearAction, generators=[[[0.0, 1.0], [-1.0, 0.0]]]),
    call(frames.MatrixFrame, matrices=[[[0.0, 1.0], [0.0, 0.0]]], columns=2),
    call(frames.FieldFrame, fields=[np.ones_like], flow=np.add, point_shape=2),
])  # fmt: skip


def of_problem(problem):
    """Return calls of a problem: its class, and its methods."""
    kind = type(problem).__name__
    values = {name: getattr(problem, name) for name in inspect.signature(type(problem)).parameters}
    yield f"problems.{kind}", Call(type(problem), values)
    points = {"y": problem.y0} if hasattr(problem, "y0") else {}
    arguments = {"invariants": points, "body_momentum": points}
    for method, values in arguments.items():
        if callable(getattr(problem, method, None)):
            yield f"problems.{kind}.{method}", Call(getattr(problem, method), values)


PROBLEMS = [
    problems.AffineField(SO3, np.eye(3)), problems.ForcedRigidBody(), problems.FreeRigidBody(),
    problems.HeavyTop(), problems.StateDependentRotation(),
]  # fmt: skip

for _name, _frame in FRAMES.items():
    FRAME_EXAMPLES.update(of_frame(_name, _frame))
for _problem in PROBLEMS:
    FRAME_EXAMPLES.update(of_problem(_problem))

"""Equations, flows and flows between points as compiled code computes them."""

import ctypes
from types import SimpleNamespace

import numpy as np

from cg import frames as fr
from cg.frames.blocks import apply_operation
from cg.frames.facts import facts_of
from cg.support.shared_numbers import Operation


def compiled_flows(frame):
    """Return a function that moves points, shape (..., *shape), along flows (..., count, dim)."""

    def move(v, y, restore=True):
        start, count = np.array(y, dtype=frame.dtype), v[..., 0, 0].size
        moved = np.empty_like(start)
        apply_operation(
            Operation.FLOW, frame.compiled_blocks(), int(restore), count, v, start, moved
        )
        return moved

    return move


def difference_of(frame):
    """Return `Frame.exp_coordinates`, compiled where possible."""
    if not facts_of(frame).has_difference:
        return frame.exp_coordinates
    blocks, rank = frame.compiled_blocks(), len(frame.point_shape)

    def difference(y0, y1):
        v = np.empty((*y0.shape[: y0.ndim - rank], frame.dim))
        apply_operation(Operation.COORDINATES, blocks, 0, v.size // frame.dim, y0, y1, v)
        return v

    return difference


DOUBLES = ctypes.POINTER(ctypes.c_double)
ONE = [1.0, 0.0, 0.0, 0.0]
UNIT = [0.0, 0.0, 0.0, 1.0]
SU2_POINT = [0.6, 0.8, 0.0, 0.0, 0.0, 0.0, 0.6, -0.8]

FRAMES = {
    "SO3 body": (fr.SO3(), np.eye(3)),
    "SO3 space": (fr.SO3("space"), np.eye(3)),
    "SO(3)": (fr.SO(3), np.eye(3)),
    "quaternion body": (fr.UnitQuaternion(), UNIT),
    "quaternion space": (fr.UnitQuaternion("space"), UNIT),
    "quaternion body, scalar first": (fr.UnitQuaternion(scalar_first=True), ONE),
    "quaternion space, scalar first": (fr.UnitQuaternion("space", scalar_first=True), ONE),
    "SE3 body": (fr.SE3(), np.eye(4)),
    "SE3 space": (fr.SE3("space"), np.eye(4)),
    "SE3 with two translations": (fr.Semidirect(fr.SO3(), 2), np.eye(5)),
    "SE3 space with three translations": (fr.Semidirect(fr.SO(3, "space"), 3), np.eye(6)),
    "sphere": (fr.Sphere(2), [0.0, 0.6, 0.8]),
    "SU2 space": (fr.Product(fr.SU(2)), SU2_POINT),
    "SU2 body": (fr.Product(fr.SU(2, "body")), SU2_POINT),
    "Euclidean": (fr.Euclidean(5), np.arange(5.0)),
    "product": (
        fr.Product(
            fr.SE3("space"), fr.Product(fr.Sphere(2), fr.Euclidean(2)), fr.UnitQuaternion(),
            fr.SU(2), fr.SO3(),
        ),
        np.concatenate([np.eye(4).ravel(), [0, 0, 1, 3, -2], UNIT, SU2_POINT, np.eye(3).ravel()]),
    ),
}  # fmt: skip
# symmetric matrices with given eigenvalues, and products of these
ORBITS = [
    fr.IsospectralOrbit((0.0, 1.0)), fr.IsospectralOrbit((-1.0, 0.25, 1.5)),
    fr.IsospectralOrbit((1.0, 2.0, 4.0, 7.0)), fr.IsospectralOrbit((0.0, 0.0, 1.0, 1.0, 1.0)),
    fr.IsospectralOrbit((-2.0, 0.0, 1e-9, 2e-9, 1.0, 3.0)), fr.IsospectralOrbit(tuple(range(12))),
    fr.Power(fr.IsospectralOrbit((-1.0, 0.5, 2.0, 2.5)), 3),
    fr.Product(fr.IsospectralOrbit((0.0, 3.0)), fr.IsospectralOrbit((-1.0, 0.25, 1.5))),
    fr.IsospectralOrbit(tuple(np.arange(14) / 7)), fr.Grassmann(4, 1), fr.Grassmann(13, 5),
]  # fmt: skip


def affine_problem(frame, initial):
    """Return an equation with coefficients that are affine in time and the point, at random."""
    rng, y0 = np.random.default_rng(3), frame.check_point(initial)
    constant, slope, *linear = rng.integers(-4, 5, (frame.dim, y0.size + 2)).T / 8
    linear = np.array(linear).T

    def f(t, y):
        return constant + t * slope + linear @ y.ravel()

    return SimpleNamespace(frame=frame, y0=y0, f=f, constant=constant, slope=slope, linear=linear)


PROBLEMS = {name: affine_problem(*entry) for name, entry in FRAMES.items()}

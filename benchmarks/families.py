"""Random families of problems on which error estimates are judged."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

import cg
from cg.frames import SE3, SO3, SU, Euclidean, Frame, Product, Sphere, UnitQuaternion

Array = NDArray[np.float64]
Field = Callable[[Any, Any, Array], Array]
"""``f(t, y, p)`` for times ``(k,)``, points and rows of parameters."""

FRAMES = (SO3(), UnitQuaternion(), SE3(), SU(2), SU(3), Sphere(2), Euclidean(4))
_SEED = 36
_REFERENCE = 1e-13


@dataclass(frozen=True)
class Family:
    """Problems with the same equation and random parameters and starts.

    Attributes
    ----------
    name : str
    frame : Frame
    f : callable
    points : array of points, shape (n, *frame.point_shape)
    parameters : (n, p) array
    end : float
    """

    name: str
    frame: Frame
    f: Field
    points: NDArray[Any]
    parameters: Array
    end: float

    def solve(self, method: str, tolerance: float) -> NDArray[Any]:
        """Return the ends of all members."""
        run = cg.solve_ensemble(
            self.f, (0.0, self.end), self.points, frame=self.frame, method=method,
            parameters=self.parameters, vectorized=True, rtol=tolerance, atol=tolerance,
        )  # fmt: skip
        return np.asarray(run.y[-1])

    def reference(self) -> NDArray[Any]:
        """Return the ends, by a pair whose results don't share flows."""
        return self.solve("Verner8(7)", _REFERENCE)

    def errors(self, ends: NDArray[Any], exact: NDArray[Any]) -> Array:
        """Return root mean squares of errors, relative to 1 + the size of the solution."""
        difference = self.frame.exp_coordinates(exact, ends)
        assert difference is not None
        sizes = 1.0 + self.frame.coordinate_sizes(exact)
        return np.asarray(np.sqrt(((difference / sizes) ** 2).mean(axis=-1)))


def families(count: int, frames: tuple[Frame, ...] = FRAMES) -> Iterator[Family]:
    """Yield all families on some frames, each with a number of members."""
    for k, frame in enumerate(frames):
        for number, make in enumerate((_nearly_free, _spin, _drift, _weak, _strong)):
            yield make(frame, count, np.random.default_rng((_SEED, k, number)))


def _nearly_free(frame: Frame, count: int, random: np.random.Generator) -> Family:
    """Return free bodies with inertias within 10 per cent: momenta turn slowly, bodies fast."""
    body = Euclidean(3) if isinstance(frame, Euclidean) else frame
    product, d = Product(body, Euclidean(body.dim)), body.dim

    def f(t: Any, y: Any, inertia: Array) -> Array:
        m = product.split(y)[1]
        velocity = m / inertia
        turn = np.cross(m, velocity) if isinstance(body, Euclidean) else body.bracket(m, velocity)
        return np.concatenate([velocity, turn], axis=-1)

    starts = [
        product.join(body.random_point(random), _sized(random, d, 0.3, 5.0)) for _ in range(count)
    ]
    inertia = 1.0 + random.uniform(-0.05, 0.05, (count, d))
    return Family("nearly free", product, f, np.stack(starts), inertia, 10.0)


def _spin(frame: Frame, count: int, random: np.random.Generator) -> Family:
    """Return problems with a spin of 5 to 30 rad/s, and a small part that depends on the point."""
    d, entries = frame.dim, _entries(frame)

    def f(t: Any, y: Any, p: Array) -> Array:
        return p[:, :d] + 0.3 * _linear(p[:, d:], y, d, entries)

    rows = [_sized(random, d, 5.0, 30.0) for _ in range(count)]
    return _family("spin", frame, f, random, np.stack(rows), d * entries)


def _drift(frame: Frame, count: int, random: np.random.Generator) -> Family:
    """Return problems with a constant generator with a slow drift in time."""
    d = frame.dim

    def f(t: Any, y: Any, p: Array) -> Array:
        x, size, frequency, *rest = np.split(p, [d, d + 1, d + 2, 2 * d + 2, 3 * d + 2], axis=1)
        t = np.reshape(t, (-1, 1))
        shape = rest[0] * t + rest[1] * t**2 + rest[2] * np.sin(frequency * t)
        return np.asarray(x + size * shape)

    rows = [
        [*_sized(random, d, 1.0, 30.0), 10.0 ** random.uniform(-4, -0.5), random.uniform(0.5, 3.0)]
        for _ in range(count)
    ]
    return replace(_family("slow drift", frame, f, random, np.array(rows), 3 * d), end=4.0)


def _weak(frame: Frame, count: int, random: np.random.Generator) -> Family:
    """Return problems with a field that depends on time, and weakly on the point."""
    return _dependent("weak", frame, count, random, 0.1)


def _strong(frame: Frame, count: int, random: np.random.Generator) -> Family:
    """Return problems with a field that depends strongly on the point: errors grow."""
    return _dependent("strong", frame, count, random, 2.0)


def _dependent(
    name: str, frame: Frame, count: int, random: np.random.Generator, size: float
) -> Family:
    d, entries = frame.dim, _entries(frame)

    def f(t: Any, y: Any, p: Array) -> Array:
        amplitude, frequency, phase, weights = np.split(p, [d, 2 * d, 3 * d], axis=1)
        t = np.reshape(t, (-1, 1))
        own = np.tanh(_linear(weights, y, d, entries) / np.sqrt(entries))
        return np.asarray(amplitude * np.cos(frequency * t + phase) + size * own)

    rows = [
        [*random.normal(size=d), *random.uniform(0.2, 4.0, d), *random.uniform(0.0, 6.0, d)]
        for _ in range(count)
    ]
    return _family(name, frame, f, random, np.array(rows), d * entries)


def _family(
    name: str, frame: Frame, f: Field, random: np.random.Generator, rows: Array, normals: int
) -> Family:
    """Return a family whose further parameters are normally distributed, up to t = 3."""
    points = np.stack([frame.random_point(random) for _ in rows])
    parameters = np.hstack([rows, random.normal(size=(len(rows), normals))])
    return Family(name, frame, f, points, parameters, 3.0)


def _sized(random: np.random.Generator, d: int, least: float, largest: float) -> Array:
    """Return a vector of random direction and a length between two numbers."""
    v = random.normal(size=d)
    length = np.exp(random.uniform(np.log(least), np.log(largest)))
    return np.asarray(length * v / np.linalg.norm(v))


def _entries(frame: Frame) -> int:
    return int(np.prod(frame.point_shape)) * (2 if frame.dtype == np.complex128 else 1)


def _linear(weights: Array, y: Any, d: int, entries: int) -> Array:
    """Return the products of matrices ``(k, d * entries)`` with the entries of points."""
    k = len(weights)
    flat = np.ascontiguousarray(y).reshape(k, -1).view(np.float64)
    return np.asarray(np.einsum("kij,kj->ki", weights.reshape(k, d, entries), flat))

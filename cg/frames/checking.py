"""Consistency checks of a frame: flow, fields, coordinates and brackets."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from cg.frames.base import Frame, check_frame
from cg.support.arrays import Array, Points
from cg.support.checks import check_generator

# Relative tolerances of identities, and of derivatives by differences of order four
_IDENTITY = 1e-10
_DIFFERENCES = 1e-7
# Largest length of random coefficients; longer ones may have non-unique or overflowing flows
_LENGTH = 0.7
_STEP = 1e-3
_STEPS = np.array([-2.0, -1.0, 1.0, 2.0])
_WEIGHTS = np.array([1.0, -8.0, 8.0, -1.0]) / 12.0


def check(
    frame: Frame, *, rng: np.random.Generator | None = None, points: ArrayLike | None = None
) -> None:
    r"""Check that the methods of a frame are consistent with each other.

    At random points and with random coefficients it checks that ``flow(0, y)`` is ``y``, that
    flows along one field compose, that the derivative of the flow is ``field``, which
    ``coefficients`` inverts, that ``exp_coordinates`` and ``local_coordinates`` invert the flow,
    that ``bracket`` is the commutator of the fields, that ``dexpinv`` agrees with derivatives of
    flows, and that flows stay on the manifold. It computes some hundred flows.

    Parameters
    ----------
    frame
        Built-in, or your own.
    rng
        Random generator for points and coefficients, by default
        ``numpy.random.default_rng(0)``.
    points
        Points to check at, shape ``(count, *point_shape)``, by default three of
        ``random_point``.

    Raises
    ------
    ValueError
        If a check fails, or if ``points`` aren't points; the message lists all failed checks.
    TypeError
        If ``rng`` isn't a generator.
    NotImplementedError
        If ``points`` is None and the frame has no ``random_point``.

    Examples
    --------
    A flow with the wrong sign, which an integration would not reveal:

    >>> import numpy as np
    >>> from cg.frames import FieldFrame, check
    >>> frame = FieldFrame(
    ...     [lambda y: np.array([y[0], -y[1]])],
    ...     lambda v, y: np.array([y[0] * np.exp(-v[0]), y[1] * np.exp(v[0])]),
    ...     point_shape=2,
    ... )
    >>> try:
    ...     check(frame)
    ... except ValueError as error:
    ...     print(str(error).partition(" (")[0])
    frame is inconsistent: flow has the wrong sign: its derivative is -field(v, y)
    """
    check_frame(frame)
    rng = np.random.default_rng(0) if rng is None else check_generator("rng", rng)
    if points is None:
        y = frame.random_point(rng, 3)
    else:
        y = frame.read_points(points, "points")
        if y.shape[1:] != frame.point_shape or len(y) == 0:
            shape = ", ".join(map(str, ("count", *frame.point_shape)))
            raise ValueError(f"points must have shape ({shape}), got {y.shape}")
    problems = _find_inconsistencies(frame, y, rng)
    if problems:
        raise ValueError(f"frame is inconsistent: {'; '.join(problems)}")


def _find_inconsistencies(frame: Frame, points: Points, rng: np.random.Generator) -> list[str]:
    """Return a description of each inconsistency at points of shape ``(count, *point_shape)``."""
    errors: dict[str, float] = {}
    for y in points:
        normal = rng.standard_normal((3, frame.dim))
        u, v, w = (x * (_LENGTH / max(float(np.linalg.norm(x)), _LENGTH)) for x in normal)
        for compare in _CHECKS:
            for problem, size in compare(frame, y, u, v, w):
                errors[problem] = max(size, errors.get(problem, 0.0))
    return [f"{problem} (by {size:.2g})" for problem, size in errors.items()]


_Problems = Iterator[tuple[str, float]]


def _size(*points: Any) -> float:
    return max(1.0, *(float(np.abs(point).max()) for point in points))


def _compare(
    problem: str, actual: Any, expected: Any, tolerance: float, scale: float = 1.0
) -> _Problems:
    """Yield a problem and the size of the error unless two arrays agree."""
    difference = float(np.abs(np.asarray(actual) - expected).max(initial=0.0))
    if not difference <= tolerance * max(scale, _size(expected)):
        yield problem, difference


def _derivative(function: Callable[[float], Any]) -> Any:
    """Return the derivative of a function at zero, by differences of order four."""
    values = np.array([function(s * _STEP) for s in _STEPS])
    return np.tensordot(_WEIGHTS, values, 1) / _STEP


def _check_flow(frame: Frame, y: Points, u: Array, v: Array, w: Array) -> _Problems:
    flowed = frame.flow(v, y)
    yield from _compare("flow(0, y) isn't y", frame.flow(0.0 * v, y), y, _IDENTITY)
    yield from _compare(
        "flow(a v, flow(b v, y)) isn't flow((a + b) v, y)",
        frame.flow(0.3 * v, frame.flow(0.7 * v, y)), flowed, _IDENTITY,
    )  # fmt: skip
    batch = frame.flow(np.stack([v, u]), np.stack([y, y]))
    yield from _compare("flow of a batch isn't the flow of each point", batch[0], flowed, _IDENTITY)


def _check_field(frame: Frame, y: Points, u: Array, v: Array, w: Array) -> _Problems:
    tangent = frame.field(v, y)
    total = frame.field(u, y) + 2.0 * tangent
    yield from _compare("field isn't linear in v", frame.field(u + 2.0 * v, y), total, _IDENTITY)
    slope = _derivative(lambda s: frame.flow(s * v, y))
    yield from _compare_derivative(
        "field(v, y) isn't the derivative of flow(s v, y) by s",
        "flow has the wrong sign: its derivative is -field(v, y)",
        slope, tangent, _size(y),
    )  # fmt: skip


def _compare_derivative(
    problem: str, opposite: str, actual: Any, expected: Any, scale: float
) -> _Problems:
    """Yield a problem as `_compare`, or the opposite one if only the sign is wrong."""
    if not any(True for _ in _compare("", actual, -expected, _DIFFERENCES, scale)):
        problem = opposite
    yield from _compare(problem, actual, expected, _DIFFERENCES, scale)


def _check_coefficients(frame: Frame, y: Points, u: Array, v: Array, w: Array) -> _Problems:
    tangents = frame.field(np.stack([u, v]), y)
    coefficients = frame.coefficients(y, tangents)
    problem = "field(coefficients(y, dy), y) isn't dy"
    yield from _compare(problem, frame.field(coefficients, y), tangents, _IDENTITY, _size(y))
    shortest = frame.without_isotropy(coefficients, y)
    yield from _compare(
        "coefficients have isotropy", shortest, coefficients, _IDENTITY, _size(u, v)
    )


def _check_membership(frame: Frame, y: Points, u: Array, v: Array, w: Array) -> _Problems:
    yield from _compare("points aren't on the manifold", frame.relative_error(y), 0.0, _IDENTITY)
    flowed = frame.flow(v, y)
    yield from _compare("flow leaves the manifold", frame.relative_error(flowed), 0.0, _IDENTITY)
    yield from _compare("distance(y, y) isn't 0", frame.distance(y, y), 0.0, 1e-6)
    try:
        nearest = frame.project(y)
    except NotImplementedError:
        return
    yield from _compare("project moves points of the manifold", nearest, y, _IDENTITY)


def _check_coordinates(frame: Frame, y: Points, u: Array, v: Array, w: Array) -> _Problems:
    flowed = frame.flow(v, y)
    logarithm = frame.exp_coordinates(y, flowed)
    if logarithm is not None and np.isfinite(logarithm).all():
        problem = "flow(exp_coordinates(y0, y1), y0) isn't y1"
        yield from _compare(problem, frame.flow(logarithm, y), flowed, _IDENTITY)
    near = frame.flow(0.01 * v, y)
    coordinates = frame.local_coordinates(y, near)
    if np.isfinite(coordinates).all():
        problem = "flow(local_coordinates(y0, y1), y0) isn't y1"
        yield from _compare(problem, frame.flow(coordinates, y), near, _IDENTITY)


def _check_brackets(frame: Frame, y: Points, u: Array, v: Array, w: Array) -> _Problems:
    try:
        bracket = frame.bracket(u, v)
    except NotImplementedError:
        return
    tangent = frame.field(bracket, y)
    commutator = _derivative(lambda s: frame.field(u, frame.flow(s * v, y)))
    commutator = commutator - _derivative(lambda s: frame.field(v, frame.flow(s * u, y)))
    yield from _compare_derivative(
        "field(bracket(u, v), y) isn't the commutator DU V - DV U of the fields",
        "bracket has the wrong sign: it is the commutator DV U - DU V",
        commutator, tangent, _size(y),
    )  # fmt: skip
    yield from _compare(
        "bracket(v, u) isn't -bracket(u, v)", frame.bracket(v, u), -bracket, _IDENTITY
    )
    terms = [frame.bracket(a, frame.bracket(b, c)) for a, b, c in ((u, v, w), (v, w, u), (w, u, v))]
    yield from _compare(
        "bracket violates Jacobi's identity", sum(terms), 0.0 * bracket, _IDENTITY, _size(*terms)
    )
    small = 0.2 * u
    change = frame.dexpinv(small, v, order=20)
    if not np.isfinite(change).all():
        return
    slope = _derivative(lambda s: frame.flow(small + s * change, y))
    flowed = frame.flow(small, y)
    yield from _compare(
        "dexpinv(u, v) isn't the derivative of coordinates u of a point that moves with v",
        slope, frame.field(v, flowed), _DIFFERENCES, _size(flowed),
    )  # fmt: skip


_CHECKS = (
    _check_flow,
    _check_field,
    _check_coefficients,
    _check_membership,
    _check_coordinates,
    _check_brackets,
)

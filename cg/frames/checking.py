"""Consistency checks of a frame: flow, fields, coordinates and brackets."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import suppress
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
CENTRAL_STEPS = np.array([-2.0, -1.0, 1.0, 2.0])
CENTRAL_WEIGHTS = np.array([1.0, -8.0, 8.0, -1.0]) / 12.0
"""The central difference of order four, of values at these steps."""


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
    >>> import crouch_grossman as cg
    >>> frame = cg.frames.FieldFrame(
    ...     [lambda y: np.array([y[0], -y[1]])],
    ...     lambda v, y: np.array([y[0] * np.exp(-v[0]), y[1] * np.exp(v[0])]),
    ...     point_shape=2,
    ... )
    >>> try:
    ...     cg.frames.check(frame)
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
        vectors = (x * (_LENGTH / max(float(np.linalg.norm(x)), _LENGTH)) for x in normal)
        for problem, actual, expected, tolerance, *scale in _identities(frame, y, *vectors):
            bound = tolerance * _size(expected, *scale)
            size = _difference(actual, expected)
            if not size <= bound:
                opposite = problem in _OPPOSITES and _difference(actual, -expected) <= bound
                name = _OPPOSITES[problem] if opposite else problem
                errors[name] = max(size, errors.get(name, 0.0))
    return [f"{problem} (by {size:.2g})" for problem, size in errors.items()]


def _size(*points: Any) -> float:
    return max(1.0, *(float(np.abs(point).max(initial=0.0)) for point in points))


def _difference(actual: Any, expected: Any) -> float:
    return float(np.abs(np.asarray(actual) - expected).max(initial=0.0))


def _derivative(function: Callable[[float], Any]) -> Any:
    """Return the derivative of a function at zero, by differences of order four."""
    values = np.array([function(s * _STEP) for s in CENTRAL_STEPS])
    return np.tensordot(CENTRAL_WEIGHTS, values, 1) / _STEP


_SLOPE = "field(v, y) isn't the derivative of flow(s v, y) by s"
_COMMUTATOR = "field(bracket(u, v), y) isn't the commutator DU V - DV U of the fields"
_OPPOSITES = {  # problems where only the sign is wrong
    _SLOPE: "flow has the wrong sign: its derivative is -field(v, y)",
    _COMMUTATOR: "bracket has the wrong sign: it is the commutator DV U - DU V",
}
_Identities = Iterator[tuple[Any, ...]]


def _identities(frame: Frame, y: Points, u: Array, v: Array, w: Array) -> _Identities:
    """Yield what should be equal: the problem if it isn't, both sides, and a relative tolerance.

    It is relative to the second side, or to what follows it if that is larger.
    """
    moved, tangent = frame.flow(v, y), frame.field(v, y)
    yield "flow(0, y) isn't y", frame.flow(0.0 * v, y), y, _IDENTITY
    composed = frame.flow(0.3 * v, frame.flow(0.7 * v, y))
    yield "flow(a v, flow(b v, y)) isn't flow((a + b) v, y)", composed, moved, _IDENTITY
    batch = frame.flow(np.stack([v, u]), np.stack([y, y]))
    yield "flow of a batch isn't the flow of each point", batch[0], moved, _IDENTITY
    total = frame.field(u, y) + 2.0 * tangent
    yield "field isn't linear in v", frame.field(u + 2.0 * v, y), total, _IDENTITY
    slope = _derivative(lambda s: frame.flow(s * v, y))
    yield _SLOPE, slope, tangent, _DIFFERENCES, y

    tangents = frame.field(np.stack([u, v]), y)
    recovered = frame.coefficients(y, tangents)
    problem = "field(coefficients(y, dy), y) isn't dy"
    yield problem, frame.field(recovered, y), tangents, _IDENTITY, y
    horizontal = frame.without_isotropy(recovered, y)
    yield "coefficients have isotropy", horizontal, recovered, _IDENTITY, u, v

    yield "points aren't on the manifold", frame.relative_error(y), 0.0, _IDENTITY
    yield "flow leaves the manifold", frame.relative_error(moved), 0.0, _IDENTITY
    with suppress(NotImplementedError):
        yield "project moves points of the manifold", frame.project(y), y, _IDENTITY

    near = frame.flow(0.01 * v, y)
    for name, method, end in (
        ("exp_coordinates", frame.exp_coordinates, moved),
        ("local_coordinates", frame.local_coordinates, near),
    ):
        x = method(y, end)
        if x is not None and np.isfinite(x).all():
            yield f"flow({name}(y0, y1), y0) isn't y1", frame.flow(x, y), end, _IDENTITY
    with suppress(NotImplementedError):
        yield from _identities_of_brackets(frame, y, u, v, w)


def _identities_of_brackets(frame: Frame, y: Points, u: Array, v: Array, w: Array) -> _Identities:
    bracket = frame.bracket(u, v)
    along_v = _derivative(lambda s: frame.field(u, frame.flow(s * v, y)))
    along_u = _derivative(lambda s: frame.field(v, frame.flow(s * u, y)))
    yield _COMMUTATOR, along_v - along_u, frame.field(bracket, y), _DIFFERENCES, y
    yield "bracket(v, u) isn't -bracket(u, v)", frame.bracket(v, u), -bracket, _IDENTITY
    terms = [frame.bracket(a, frame.bracket(b, c)) for a, b, c in ((u, v, w), (v, w, u), (w, u, v))]
    yield "bracket violates Jacobi's identity", sum(terms), 0.0 * bracket, _IDENTITY, *terms
    small = 0.2 * u
    change = frame.dexpinv(small, v, order=20)
    if np.isfinite(change).all():
        slope, near = _derivative(lambda s: frame.flow(small + s * change, y)), frame.flow(small, y)
        problem = "dexpinv(u, v) isn't the derivative of coordinates u of a point that moves with v"
        yield problem, slope, frame.field(v, near), _DIFFERENCES, near

"""Joints of mechanical systems, and constraints of one's own, as compiled code reads them."""

from __future__ import annotations

import weakref
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cg import _core_r64 as core
from cg.frames.base import Frame
from cg.frames.blocks import describe_blocks
from cg.frames.euclidean import Euclidean
from cg.frames.inertia import rows_times
from cg.frames.product import Power, Product
from cg.frames.quaternion import UnitQuaternion
from cg.frames.rotations import SO3
from cg.support.arrays import Array, Points, check_finite, real_array
from cg.support.checks import check_choice, check_integer, check_real, short
from cg.support.shared_numbers import BlockKind, LoopStatus, RowForm

Row = tuple[RowForm, int, int]  # the form of a row, and the axes of both bodies

_POINT: tuple[Row, ...] = tuple((RowForm.ALONG_SPACE, k, 0) for k in range(3))
_ATTITUDE: tuple[Row, ...] = tuple((RowForm.COINCIDENT_AXES, k, (k + 1) % 3) for k in range(3))
KINDS: dict[str, tuple[Row, ...]] = {
    "ball": _POINT,
    "hinge": (*_POINT, (RowForm.BETWEEN_AXES, 2, 0), (RowForm.BETWEEN_AXES, 2, 1)),
    "universal": (*_POINT, (RowForm.BETWEEN_AXES, 2, 2)),
    "slider": ((RowForm.ALONG_BODY, 0, 0), (RowForm.ALONG_BODY, 1, 0), *_ATTITUDE),
    "fixed": (*_POINT, *_ATTITUDE),
    "distance": ((RowForm.FIXED_LENGTH, 0, 0),),
}
"""The rows of each kind of joint."""

_ORTHONORMAL = 1e-8  # largest error of orthonormal axes
# Weights of differences for the derivatives of orders one and two, times powers of the step: of
# five values, and of three, whose difference from those of five estimates the error
_DIFFERENCES = {
    1: (np.array([1.0, -8.0, 0.0, 8.0, -1.0]) / 12.0, np.array([0.0, -0.5, 0.0, 0.5, 0.0])),
    2: (np.array([-1.0, 16.0, -30.0, 16.0, -1.0]) / 12.0, np.array([0.0, 1.0, -2.0, 1.0, 0.0])),
}
_STEP, _LONG_STEP = 1e-3, 2.5e-3  # first steps of both orders, for angles and lengths of about 1
_CHANGE, _TRIALS = 8.0, 14  # factor by which steps change, and how often they do
_ALLOWED = 1e-9  # relative error at which steps don't change
_ROUNDING_FACTOR = 8.0  # errors of differences, in rounding errors of values
_WRONG = 1e-5  # relative error at which derivatives by the user are refused
_DEPENDENT = 1e-12  # least eigenvalue of a regular matrix G J⁻¹ Gᵀ with unit diagonal


@dataclass(frozen=True, init=False)
class Joint:
    """A joint between two bodies of a `PhaseSpace`, or between a body and the ground.

    Parameters
    ----------
    kind
        | ``"ball"``: the points coincide (3 constraints).
        | ``"hinge"``: the points coincide, and the third axes are parallel (5).
        | ``"universal"``: the points coincide, and the third axes are orthogonal (4).
        | ``"slider"``: the axes coincide, and the second body moves along the third one (5).
        | ``"fixed"``: points and axes coincide (6).
        | ``"distance"``: the points have a fixed distance, as if joined by a rod (1).
    first, second
        Where the joint is attached to each body: ``(body, point)`` or ``(body, point, axes)``. A
        body is its number, from 0, or None for the ground. The point, shape ``(3,)``, is in the
        axes of the body, from its centre of mass. The axes are the columns of a rotation matrix in
        those of the body, by default the identity; or the third one alone, shape ``(3,)``, where
        the kind depends on no other.
    length
        The distance of the points, of ``"distance"`` alone.

    Raises
    ------
    TypeError, ValueError
        If the kind is unknown, or an attachment isn't of this form.

    Examples
    --------
    A pendulum that swings about the first axis of space, and a rod:

    >>> pivot = Joint("hinge", (None, [0, 0, 2], [1, 0, 0]), (0, [0, 0, 0.5], [1, 0, 0]))
    >>> len(pivot)
    5
    >>> len(Joint("distance", (0, [0, 0, 0]), (1, [0, 0, 0]), length=0.3))
    1
    """

    kind: str
    first: tuple[Any, ...]
    second: tuple[Any, ...]
    length: float | None

    def __init__(self, kind: str, first: Any, second: Any, *, length: float | None = None) -> None:
        check_choice("kind", kind, KINDS)
        both = _attachment(first, "first", kind), _attachment(second, "second", kind)
        if both[0][0] == both[1][0]:
            raise ValueError(f"first and second must be different bodies, got {both[0][0]} twice")
        if (length is None) == (kind == "distance"):
            raise ValueError(
                f"length must be given with 'distance' alone, got {length} with {kind!r}"
            )
        if length is not None:
            length = check_real("length", length, positive=True)
        vars(self).update(kind=kind, first=both[0], second=both[1], length=length)

    def __len__(self) -> int:
        """Return the number of constraints."""
        return len(KINDS[self.kind])

    @property
    def bodies(self) -> tuple[int, int]:
        """The numbers of both bodies, -1 for the ground."""
        first, second = (-1 if end[0] is None else end[0] for end in (self.first, self.second))
        return first, second

    def rows(self) -> Iterator[tuple[list[int], list[float]]]:
        """Yield the constraints as integers and numbers, see `make_linkage` in Fortran."""
        points = [*self.first[1], *self.second[1]]
        axes = [np.array(end[2]).T if end[2] else np.eye(3) for end in (self.first, self.second)]
        for form, i, j in KINDS[self.kind]:
            first_axes = np.eye(3) if form is RowForm.ALONG_SPACE else axes[0]
            integers = [int(form), *(body + 1 for body in self.bodies)]
            yield integers, [*points, *first_axes[i], *axes[1][j], self.length or 0.0]


def _attachment(value: Any, name: str, kind: str) -> tuple[Any, ...]:
    """Return a body, a point and axes as hashable numbers."""
    if not isinstance(value, tuple | list) or len(value) not in (2, 3):
        raise ValueError(f"{name} must be (body, point) or (body, point, axes), got {short(value)}")
    body = None if value[0] is None else check_integer(f"the body of {name}", value[0], 0)
    point = real_array(value[1], f"the point of {name}")
    if point.shape != (3,) or not np.isfinite(point).all():
        raise ValueError(f"the point of {name} must be three finite numbers, got {short(value[1])}")
    axes: Any = value[2] if len(value) == 3 else ()
    if isinstance(axes, tuple) and not axes:  # as a joint without axes has stored it
        return body, tuple(point.tolist()), ()
    axes = real_array(axes, f"the axes of {name}")
    return body, tuple(point.tolist()), _axes(axes, name, kind)


def _axes(axes: Array, name: str, kind: str) -> tuple[tuple[float, ...], ...]:
    """Return rows of a rotation matrix, which is completed if the third axis alone is given."""
    if kind in ("ball", "distance"):
        raise ValueError(f"the axes of {name} must not be given with {kind!r}, which has none")
    if axes.shape == (3,) and kind in ("hinge", "universal"):
        length = np.linalg.norm(axes)
        if not 0.0 < length < np.inf:
            raise ValueError(f"the axis of {name} must have a positive, finite length, got {axes}")
        third = axes / length
        first = np.cross(third, np.eye(3)[np.abs(third).argmin()])
        first /= np.linalg.norm(first)
        axes = np.column_stack([first, np.cross(third, first), third])
    if (
        axes.shape != (3, 3)
        or not np.abs(axes.T @ axes - np.eye(3)).max() <= _ORTHONORMAL
        or np.linalg.det(axes) < 0.0
    ):
        raise ValueError(f"the axes of {name} must be the columns of a rotation matrix, got {axes}")
    return tuple(map(tuple, axes.tolist()))


def bodies_of(frame: Frame) -> list[list[int]]:
    """Return the blocks of attitude and position of each rigid body, from 1, 0 for none.

    An attitude and a position are those of one body if they follow each other in the same product,
    in any order.
    """
    bodies: list[list[int]] = []
    half: list[int] | None = None  # a body of the factor before, an attitude or a position alone
    product_before = None
    for block, (factor, product) in enumerate(_factors_in(frame), 1):
        attitude = isinstance(factor, SO3 | UnitQuaternion)
        if not attitude and factor != Euclidean(3):
            half = None
        elif half and half[attitude] and product is product_before is not None:
            half[not attitude], half = block, None
        else:
            half = [block, 0] if attitude else [0, block]
            bodies.append(half)
        product_before = product
    return bodies


def _factors_in(frame: Frame, product: object = None) -> Iterator[tuple[Frame, object]]:
    """Yield the factors of nested products and powers, each with an object for its product."""
    if type(frame) is Product:
        product = object()
        for factor in frame.factors:
            yield from _factors_in(factor, product)
    elif type(frame) is Power:
        for _ in range(frame.n):
            yield from _factors_in(frame.factor)
    else:
        yield frame, product


class Linkage:
    """The joints and constraints of a phase space in compiled code.

    ``frame`` is a `PhaseSpace`; ``slices`` are the rows of each joint in compiled code, then those
    of constraints.
    """

    def __init__(self, frame: Any) -> None:
        self._frame = frame
        bodies, joints = bodies_of(frame.configuration), frame.joints
        for k, joint in enumerate(joints):
            if max(joint.bodies) >= len(bodies):
                raise ValueError(
                    f"the bodies of joints[{k}] must be less than {len(bodies)}, the number of "
                    f"attitudes and positions in space of {frame.configuration!r}, got "
                    f"{joint.bodies}"
                )
        # sorted so that rows of neighbouring bodies are neighbours, as joints.f90 needs
        order = sorted(range(len(joints)), key=lambda k: sorted(joints[k].bodies)[::-1])
        rows = [(k, *row) for k in order for row in joints[k].rows()]
        joint_of_row, integers, numbers = ([row[i] for row in rows] for i in range(3))
        self.user_count = 0
        if frame.constraints is not None:
            self._g, self._dg = frame.constraints
            self.user_count = self._count()
        self.count = len(integers) + self.user_count
        self.slices = [np.flatnonzero(np.equal(joint_of_row, k)) for k in range(len(joints))]
        self.slices += [np.arange(len(integers), self.count)] * (frame.constraints is not None)
        self._reader = self._evaluate  # the only reference of compiled code to this object
        blocks = describe_blocks(frame.compiled_blocks() or ())
        self.address: int = core.plan_open(blocks, np.zeros(1), False, 0)
        weakref.finalize(self, core.plan_close, self.address)
        columns, constants = frame.compiled_bodies()
        if core.plan_set_bodies(self.address, columns, constants, 0):
            raise MemoryError("there is not enough memory for the inertia of bodies")
        core.plan_set_joints(
            self.address, _padded(bodies, 2, np.intc), _padded(integers, 3, np.intc),
            _padded(numbers, 13, np.float64), self.user_count, id(self._reader),
        )  # fmt: skip

    def _call(self, procedure: str, *rows: NDArray[Any]) -> NDArray[np.intc]:
        """Call a compiled procedure with points and what belongs to each; return a status each."""
        status = np.zeros(len(rows[0]), dtype=np.intc)
        if len(status):  # no array may be empty
            getattr(core, procedure)(self.address, *(array.T for array in rows), status)
        if (status == LoopStatus.OUT_OF_MEMORY).any():
            raise MemoryError("there is not enough memory for the constraints of joints")
        return status

    def errors(self, y: Array, relative: bool = False) -> Array:
        """Return the values of constraints and their derivatives by time, shape ``(..., 2 m)``.

        If ``relative``, both are divided by the sizes of the terms of which they are sums; rates of
        bodies that hardly move by the sizes of the constraints, per unit of time.
        """
        values, rates, sizes, rate_sizes = np.zeros((4, y.size // y.shape[-1], self.count))
        self._call("joints_errors", _rows(y), values, rates, sizes, rate_sizes)
        if relative:
            least = np.finfo(float).tiny
            values /= np.maximum(sizes, least)
            rates /= np.maximum(np.maximum(rate_sizes, sizes), least)
        return np.concatenate([values, rates], axis=-1).reshape(*y.shape[:-1], 2 * self.count)

    def close(self, y: Array) -> Array:
        """Return points with closed joints, NaN where there are none nearby."""
        rows = _rows(y).copy()
        status = self._call("joints_close", rows)
        rows[status != LoopStatus.NO_STOP] = np.nan
        return rows.reshape(y.shape)

    def forces(self, y: Array, f: Array) -> tuple[Array, Array]:
        """Return coefficients with forces of joints, and the multipliers, shape ``(..., m)``.

        Both are NaN where constraints depend on each other.
        """
        rows, fields = _rows(y), _rows(f).copy()
        multipliers = np.zeros((len(rows), self.count))
        status = self._call("joints_forces", rows, fields, multipliers)
        fields[status != LoopStatus.NO_STOP] = np.nan
        multipliers[status != LoopStatus.NO_STOP] = np.nan
        return fields.reshape(f.shape), multipliers.reshape(*y.shape[:-1], self.count)

    def check_rank(self, y: Array, name: str) -> None:
        """Raise ValueError if constraints depend on each other at a point."""
        if np.isfinite(self.forces(y, np.zeros(self._frame.dim))[1]).all():
            return
        dim = self._frame.rhs_dim
        points = np.tile(y, (dim, 1))
        points[:, -dim:] = np.eye(dim)
        rates = self.errors(points)[:, self.count :].T  # G J⁻¹, by unit momenta
        scaled = [rows_times(rates[:, body.vectors], body.root) for body in self._frame._bodies]
        matrix = np.sum([rows @ rows.T for rows in scaled], axis=0)
        scale = np.sqrt(np.maximum(np.diagonal(matrix), np.finfo(float).tiny))
        matrix /= scale * scale[:, None]
        values = np.linalg.eigvalsh(matrix)
        rank = np.count_nonzero(values > _DEPENDENT * len(values))
        raise ValueError(
            f"the constraints of joints must not depend on each other, got rank {rank} of "
            f"{self.count} at {name}; a joint with fewer of them may do, such as 'ball' for 'hinge'"
        )

    def _value(self, q: Points) -> Array:
        value = real_array(self._g(np.array(q)), "the value of constraints")
        if value.ndim != 1 or not value.size or len(value) != (self.user_count or len(value)):
            shape = f"({self.user_count or 'm'},)"
            raise ValueError(f"constraints must return shape {shape}, got {value.shape}")
        return value

    def _count(self) -> int:
        """Return how many constraints there are, after checking values and derivatives."""
        frame = self._frame.configuration
        point = frame.random_point(np.random.default_rng(0))
        value = self._value(point)
        if self._dg is not None:
            slopes, differences = self._slopes(point), self._differences(point)
            check_finite("the derivatives of constraints", slopes)
            error = np.abs(slopes - differences).max()
            error -= _ROUNDING_FACTOR * np.finfo(float).eps * np.abs(value).max() / _STEP
            if not error <= _WRONG * (1.0 + np.abs(differences).max()):
                raise ValueError(
                    "the derivatives of constraints must be those along the fields of the "
                    f"configuration, but differ by {error:.3g} from differences"
                )
        return len(value)

    def _slopes(self, q: Points) -> Array:
        """Return the derivatives along fields, shape ``(m, dim)``, as the user gives them."""
        if self._dg is None:
            return self._differences(q)
        slopes = real_array(self._dg(np.array(q)), "the derivatives of constraints")
        shape = self.user_count or len(self._value(q)), self._frame.configuration.dim
        if slopes.shape != shape:
            raise ValueError(
                f"the derivatives of constraints must have shape {shape}, got {slopes.shape}"
            )
        return slopes

    def _differences(self, q: Points) -> Array:
        """Return the derivatives along fields by differences, each with a step of its own."""
        dim, reach = self._frame.configuration.dim, self._reach(q)
        scale = np.minimum(reach, 1.0)  # a small system may be far away
        count = self.user_count or len(self._value(q))
        best, error = np.full((dim, count), np.nan), np.full(dim, np.inf)
        steps, todo, slope, largest = np.full(dim, _STEP), np.arange(dim), 0.0, 0.0
        for _ in range(_TRIALS):
            differences = [self._difference(q, v, 1) for v in np.diag(steps * scale)[todo]]
            values, truncation, sizes = map(np.array, zip(*differences, strict=True))
            slopes, truncation = values / steps[todo, None], truncation / steps[todo]
            largest = max(largest, float(np.abs(slopes).max()))
            slope = max(slope, float((np.abs(slopes) * (reach / scale)[todo, None]).max()))
            rounding = _rounding(sizes, slope) / steps[todo]
            better = truncation + rounding < error[todo]
            best[todo[better]] = slopes[better]
            error[todo[better]] = (truncation + rounding)[better]
            steps[todo] *= np.where(truncation > rounding, 1.0 / _CHANGE, _CHANGE)
            todo = todo[np.maximum(truncation, rounding) > _ALLOWED * largest]
            if not len(todo):
                break
        return (best / scale[:, None]).T

    def _reach(self, q: Points) -> Array:
        """Return the largest position for fields of positions, one for fields of attitudes."""
        doubles = np.ascontiguousarray(q).reshape(-1).view(np.float64)
        blocks = self._frame.compiled_blocks() or ()
        bodies = zip(blocks, self._frame._bodies, strict=False)
        flat = [body for block, body in bodies if block[0] == BlockKind.EUCLIDEAN]
        length = max((float(np.abs(doubles[body.points]).max()) for body in flat), default=0.0)
        reach = np.ones(self._frame.configuration.dim)
        for body in flat:
            reach[body.vectors] = length or 1.0
        return reach

    def _second_derivatives(self, q: Points, velocity: Array, slope: float) -> Array:
        """Return the second derivatives of constraints by time, where velocities are constant.

        ``slope`` is the largest first derivative, times `_reach`.
        """
        scale = np.minimum(self._reach(q), 1.0)
        speed = float(np.abs(velocity / scale).max(initial=0.0))
        if not speed > 0.0:
            return np.zeros(self.user_count)
        step, best, error = _LONG_STEP / speed, np.full(self.user_count, np.nan), np.inf
        for _ in range(_TRIALS):
            difference, truncation, size = self._difference(q, step * velocity, 2)
            rounding = _rounding(size, slope)
            if truncation == np.inf:
                step /= _CHANGE
                continue
            if not (truncation + rounding) / step**2 < error:
                break
            best, error = difference / step**2, (truncation + rounding) / step**2
            if error <= _ALLOWED * np.abs(best).max(initial=0.0):
                break
            step *= 1.0 / _CHANGE if truncation > rounding else _CHANGE
        return best

    def _difference(self, q: Points, v: Array, order: int) -> tuple[Array, float, float]:
        """Return a difference of five values along a flow, its error, and the largest value.

        The error is the square of the relative distance from the difference of three; infinite,
        with zeros, where values aren't finite, beyond which smaller steps may not lead.
        """
        points = self._frame.configuration.flow(np.arange(-2.0, 3.0)[:, None] * v, q)
        values = np.array([self._value(x) for x in points])
        if not np.isfinite(values).all():
            return np.zeros(values.shape[1]), np.inf, 0.0
        five, three = (weights @ values for weights in _DIFFERENCES[order])
        apart = float(np.abs(five - three).max())
        error = apart**2 / max(float(np.abs(five).max()), apart, 1e-300)
        return five, error, float(np.abs(values).max())

    @property
    def _evaluate(self) -> Callable[[int, Array, Array], Array]:
        """The function that compiled code calls for constraints of one's own.

        Its arguments are a depth and the doubles of a configuration. At depth 0 it returns values;
        at 1 also the sums of the derivatives' magnitudes, times `_reach` and without it, then the
        derivatives; at 2, which velocities follow, also second derivatives.
        """
        this = weakref.ref(self)

        def evaluate(_: int, depth: Array, doubles: Array) -> Array:
            self = this()
            assert self is not None
            frame = self._frame.configuration
            q: Points = doubles.view(frame.dtype).reshape(frame.point_shape)
            derivatives = [self._value(q)]
            if depth[0] > 0.0:
                slopes = self._slopes(q)
                terms = np.abs(slopes)
                derivatives += [terms @ self._reach(q), terms.sum(axis=1), slopes.ravel()]
            if depth[0] > 1.0:
                slope = float(np.abs(slopes * self._reach(q)).max())
                derivatives.append(self._second_derivatives(q, depth[1:], slope))
            return np.concatenate(derivatives)

        return evaluate


def _rounding(size: Any, slope: float) -> Any:
    """Return the rounding error of differences: of values, by size, and of points, by slope."""
    return _ROUNDING_FACTOR * float(np.finfo(float).eps) * (size + slope)


def _rows(points: Array) -> Array:
    """Return points as rows, contiguous."""
    return np.ascontiguousarray(points).reshape(-1, points.shape[-1])


def _padded(rows: Any, width: int, dtype: Any) -> NDArray[Any]:
    """Return rows as columns of an array, and a column of zeros, since no array may be empty."""
    return np.array([*rows, [0] * width], dtype=dtype).T


def read_constraints(value: Any) -> tuple[Callable[..., Any], Callable[..., Any] | None] | None:
    """Return constraints as a function and its derivatives, None if there are none."""
    if value is None:
        return None
    pair = value if isinstance(value, tuple) else (value, None)
    if len(pair) != 2 or not callable(pair[0]) or not (pair[1] is None or callable(pair[1])):
        raise TypeError(f"constraints must be a function or two of them, got {value!r}")
    return pair


def read_joints(value: Any) -> tuple[Joint, ...]:
    """Return joints as a tuple; TypeError if one of them isn't a `Joint`."""
    if not np.iterable(value):
        raise TypeError(f"joints must be a sequence of cg.frames.Joint, got {value!r}")
    joints = tuple(value)
    for k, joint in enumerate(joints):
        if not isinstance(joint, Joint):
            raise TypeError(f"joints[{k}] must be a cg.frames.Joint, got {joint!r}")
    return joints

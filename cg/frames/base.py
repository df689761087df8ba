"""The interface of a frame: vector fields whose linear combinations have computable flows."""

from __future__ import annotations

import math
from abc import abstractmethod
from dataclasses import MISSING, dataclass, fields, is_dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike

from cg.frames.algebra import FieldAlgebra
from cg.frames.blocks import Blocks, move
from cg.frames.manifold import (
    Manifold,
    local_coordinates,
    minimum_norm_coefficients,
    norms,
    usable_or_zero,
)
from cg.support.arrays import Array, Points, Size, check_random, real_array
from cg.support.checks import check_integer, short, warn_user

NORMAL_PART, NORMAL_ROUNDING = 1e-8, 1e-12
"""Largest parts of derivatives that are dropped without a warning: relative, and absolute."""

_MEAN_STEPS, _MEAN_REACHED = 200, 1e-9  # most steps towards a mean, largest last step of rounding
_NEAR = math.pi / 4  # points that all turn by less from their mean have no other
_MEAN_STARTS = 3  # points from which another mean is sought
_EQUAL = 1e-6  # largest relative difference of sums of squares, and distance, of equal means
_DIFFERENCE = 1e-8  # step of differences of flows, relative to the coefficients
_DIFFERENCE_RANK = 1e-5  # singular values of differences below this part of the largest are zero


class FlowOverflowError(OverflowError):
    """The coefficients are too large for their flow to be computed in double precision.

    Examples
    --------
    >>> import numpy as np
    >>> import crouch_grossman as cg
    >>> try:
    ...     cg.frames.SL(2).flow([1e14, 0.0, 0.0], np.eye(2))
    ... except cg.frames.FlowOverflowError as error:
    ...     print(str(error).partition(":")[0])
    the flow of v with |v| = 1e+14 can't be computed in double precision
    """


class Frame(Manifold, FieldAlgebra):
    r"""Vector fields :math:`E_1, \dots, E_m` on a manifold embedded in arrays.

    A differential equation is written in the frame as
    :math:`y' = \sum_i f_i(t, y) E_i(y)` (equation (1.1) of [1]_), and a numerical method moves
    along flows of :math:`y' = \sum_i v_i E_i(y)` with constant :math:`v` (equation (1.2)).

    A subclass is immutable, compares by value, and defines the abstract members; integrators need
    no others. Every method accepts single points and batches: ``v`` has shape ``(..., dim)``,
    ``y`` has shape ``(..., *point_shape)``, and leading axes broadcast. The coefficients ``v`` are
    always real; points are real or complex, see `dtype`.

    On matrix groups the fields are invariant under one of the two multiplications, with
    :math:`\Omega(v)` in the Lie algebra: ``convention="body"`` is :math:`y' = y\,\Omega(v)`,
    ``convention="space"`` is :math:`y' = \Omega(v)\,y`. The default is ``"body"`` for rotations
    and rigid motions (``SO3``, ``SO``, ``UnitQuaternion``, ``SE3``), since gyros measure angular
    velocities in body axes, and ``"space"`` for the other groups, since they propagate
    :math:`x' = \Omega x`. On homogeneous spaces the group acts from the left.

    References
    ----------
    .. [1] Z. Jackiewicz, A. Marthinsen, B. Owren, "Construction of Runge-Kutta methods of
       Crouch-Grossman type of high order", Adv. Comput. Math. 13 (2000), 405-415.

    Examples
    --------
    The members that all frames have, here of unit quaternions:

    >>> import numpy as np
    >>> import crouch_grossman as cg
    >>> frame = cg.frames.UnitQuaternion()
    >>> frame.dim, frame.point_shape
    (3, (4,))
    >>> y = frame.random_point(np.random.default_rng(0))
    >>> moved = frame.flow([0.1, 0.2, 0.3], y)
    >>> frame.exp_coordinates(y, moved).round(12)
    array([0.1, 0.2, 0.3])
    >>> bool(frame.membership_error(moved) < 1e-15)
    True
    """

    def __repr__(self) -> str:
        if not is_dataclass(self):
            return super().__repr__()
        arguments = []
        by_keyword = False
        for entry in fields(self):
            value = getattr(self, entry.name)
            if not entry.init:
                continue
            if entry.default is not MISSING and value == entry.default:
                by_keyword = True
                continue
            text = f'"{value}"' if isinstance(value, str) else repr(value)
            keyword = f"{entry.name}=" if by_keyword or entry.kw_only else ""
            arguments.append(keyword + text)
        return f"{type(self).__name__}({', '.join(arguments)})"

    @abstractmethod
    def field(self, v: ArrayLike, y: ArrayLike) -> Points:
        r"""Return the tangent :math:`\sum_i v_i E_i(y)`, shape ``(..., *point_shape)``."""

    @abstractmethod
    def flow(self, v: ArrayLike, y: ArrayLike) -> Points:
        r"""Return the time-1 flow of :math:`\sum_i v_i E_i` through ``y``.

        Raises
        ------
        FlowOverflowError
            If ``v`` is so large that double precision has no digits of its flow. On compact
            groups there is no such limit.
        """

    def without_isotropy(self, v: ArrayLike, y: ArrayLike) -> Array:
        """Return ``v`` without its component in the isotropy algebra of ``y``.

        The result has the same tangent at ``y`` as ``v``. By default it is ``v``; spheres return
        the coefficients of least norm.
        """
        return self._arguments(v, y)[0]

    def coefficients(self, y: ArrayLike, dy: ArrayLike) -> Array:
        """Return the coefficients of derivatives of points, the inverse of `field`.

        Where several coefficients have the same tangent, these have the least norm, without
        isotropy. A part of ``dy`` that no field has, such as a normal one, is dropped.

        Warns
        -----
        UserWarning
            If the part of ``dy`` that is dropped is larger than rounding.

        Examples
        --------
        The angular velocity of a quaternion:

        >>> import crouch_grossman as cg
        >>> cg.frames.UnitQuaternion().coefficients([0, 0, 0, 1], [0, 0, 0.5, 0])
        array([0., 0., 1.])
        """
        v, dropped = self._coefficients(self._points(y), self._points(dy, "dy"))
        excess = dropped > NORMAL_PART
        if excess.any():
            index = tuple(map(int, np.unravel_index(np.argmax(excess), excess.shape)))
            warn_user(
                f"dy has a part that the fields of {self!r} don't have, which is dropped: "
                f"{dropped[index]:.3g} of its length{f' at index {index}' if index else ''}"
            )
        return v

    def _coefficients(self, y: Points, dy: Points) -> tuple[Array, Array]:
        """Return the coefficients of derivatives, and what is dropped relative to their lengths."""
        point, tangent = np.broadcast_arrays(y, dy)
        rows, slopes = (x.reshape(-1, *self.point_shape) for x in (point, tangent))
        v = np.asarray(self._coefficients_at(rows, slopes))
        lead = point.shape[: point.ndim + 1 - rows.ndim]
        entries = np.abs([slopes - self.field(v, rows), slopes])
        # unlike sums of squares, np.hypot doesn't overflow
        dropped, sizes = np.hypot.reduce(entries, axis=tuple(range(2, entries.ndim)))
        large, sizes = dropped > NORMAL_ROUNDING, np.maximum(sizes, dropped)
        relative = np.divide(dropped, sizes, np.zeros_like(dropped), where=large)
        return v.reshape(*lead, self.dim), relative.reshape(lead)

    def exp_coordinates(self, y0: ArrayLike, y1: ArrayLike) -> Array | None:
        """Return the coefficients of least norm whose flow takes ``y0`` to ``y1``, NaN without any.

        None if the frame does not define this map; see `local_coordinates`.
        """
        self._points(y0, "y0")
        self._points(y1, "y1")
        return None

    @np.errstate(over="ignore", invalid="ignore")  # Points may be far apart.
    def local_coordinates(self, y0: ArrayLike, y1: ArrayLike) -> Array:
        r"""Return coefficients whose flow takes ``y0`` to a point ``y1`` near it.

        Every frame has them. The Gauss-Newton iteration

        .. math::

            v \leftarrow v + E(y)^+ (y_1 - y), \qquad y = \exp(\textstyle\sum_i v_i E_i) y_0 ,

        with the matrix :math:`E(y)` of the fields, starts from `exp_coordinates` where these are
        defined, on `SPD` and `Grassmann` from those of a geodesic, from zero elsewhere. It goes a
        part of the way where a whole step fails, and ends when the residual is rounding. The result
        is zero where points are equal, NaN where the iteration fails for points too far apart.
        """
        start, end = np.broadcast_arrays(self._points(y0, "y0"), self._points(y1, "y1"))
        lead = start.shape[: start.ndim - len(self.point_shape)]
        guess = self._first_coordinates(start, end)
        start, end = (y.reshape(-1, *self.point_shape) for y in (start, end))
        v = np.zeros((len(start), self.dim)) if guess is None else guess.reshape(-1, self.dim)
        v = local_coordinates(self.flow, self._correct, v, start, end)
        return v.reshape(*lead, self.dim)

    def _first_coordinates(self, y0: Points, y1: Points) -> Array | None:
        """Return coefficients from which `local_coordinates` start, None for zeros."""
        return self.exp_coordinates(y0, y1)

    def difference(self, y0: ArrayLike, y1: ArrayLike) -> Array:
        """Return y1 - y0 as coordinates: `local_coordinates`, NaN where they don't exist."""
        return self.local_coordinates(y0, y1)

    def mean(self, points: ArrayLike, weights: ArrayLike | None = None) -> Points:
        r"""Return the mean of points that are near each other.

        It is the point :math:`m` where :math:`\sum_i w_i v_i` moves nothing. On rotations, unitary
        matrices, spheres, `Grassmann`, `SPD`, `Hyperbolic` and Euclidean spaces, their products and
        powers, the v_i are tangents at m of geodesics to the points, so that it is Karcher's mean,
        where the sum of :math:`w_i d_i^2` of geodesic distances is least. On other frames, such as
        `SE3` and `Stiefel`, which have no metric of their own, v_i is the `difference` of a point
        from m. Unit quaternions of opposite signs are far apart, though they are one attitude.
        On a `PhaseSpace` momenta along points of spheres are removed, and joints are closed.

        Parameters
        ----------
        points
            Shape ``(n, *point_shape)``.
        weights
            Shape ``(n,)``, with a positive sum, by which they are divided; by default equal. Some
            may be negative, as those of unscented transforms.

        Returns
        -------
        ndarray
            Shape ``point_shape``.

        Raises
        ------
        ValueError
            If arguments have other shapes or values, or points are too far apart: if iterations
            fail, or lead from other points to another mean that is as good.
        """
        y = self._points(points, "points")
        if y.ndim != 1 + len(self.point_shape) or not len(y):
            shape = ", ".join(map(str, self.point_shape))
            raise ValueError(f"points must have shape (n, {shape}) with n > 0, got {y.shape}")
        w = np.ones(len(y)) if weights is None else real_array(weights, "weights")
        if w.shape != (len(y),) or not (np.isfinite(w).all() and w.sum() > 0.0):
            raise ValueError(
                f"weights must be {len(y)} finite numbers with a positive sum, got {short(weights)}"
            )
        w = w / w.sum()
        m = self._mean_near(y[int(np.argmax(w))], y, w)
        if m is None:
            raise ValueError(f"points must be near each other to have a mean, got {short(points)}")
        turns = np.linalg.norm(self._logarithms(m, y) * self.turning_coefficients(), axis=1)
        if turns.max() < _NEAR or w.min() < 0.0:
            return m
        others = [self._mean_near(y[k], y, w) for k in turns.argsort()[-_MEAN_STARTS:]]
        means = np.array([m, *(other for other in others if other is not None)])
        sums = np.array([w @ norms(self.field(self._logarithms(x, y), x)) ** 2 for x in means])
        distances = norms(means - means[sums.argmin()])
        if (distances[sums <= (1.0 + _EQUAL) * sums.min()] > _EQUAL * norms(means).max()).any():
            raise ValueError(
                f"points must be near each other to have one mean, got {short(points)}"
            )
        return np.asarray(means[sums.argmin()])

    def _mean_near(self, m: Points, y: Points, w: Array) -> Points | None:
        """Return the point, near ``m``, where the sum of `_logarithms` moves nothing, or None."""
        last, fraction = math.inf, 1.0
        for _ in range(_MEAN_STEPS):
            v = fraction * self.coefficients(m, self.field(w @ self._logarithms(m, y), m))
            size = (np.abs(v) / np.maximum(self.coordinate_sizes(m), 1.0)).max(initial=0.0)
            if not np.isfinite(size):
                break
            m = self.flow(v, m)
            if size >= last or size == 0.0:
                if size <= _MEAN_REACHED:
                    return m  # what is left is rounding
                fraction /= 2.0  # steps are too long
            last = size
        return None

    def _logarithms(self, m: Points, y: Points) -> Array:
        """Return the coefficients of the tangents at ``m`` to points, of which a mean is made."""
        return self.difference(m, y)

    def _nearest_coordinates(self, y0: ArrayLike, y1: ArrayLike) -> Array:
        """Return coefficients whose flow takes ``y0`` near to a point ``y1`` near it.

        They are `local_coordinates` where these exist. Elsewhere, as where the fields don't span
        the directions to ``y1``, they are those of the nearest tangent at ``y0``, or zero if their
        flow leads away.
        """
        start, end = np.broadcast_arrays(self._points(y0, "y0"), self._points(y1, "y1"))
        v = np.array(self.local_coordinates(start, end))
        lost = ~np.isfinite(v).all(axis=-1)
        if lost.any():
            start, end = start[lost], end[lost]
            with np.errstate(over="ignore", invalid="ignore"):
                tangents = usable_or_zero(self._coefficients_at(start, end - start))
                nearer = norms(end - self.flow(tangents, start)) < norms(end - start)
            v[lost] = np.where(nearer[:, None], tangents, 0.0)
        return v

    def _composed(self, flows: Array) -> Array:
        """Return the coefficients of the product of flows, zero if the frame doesn't define it.

        ``flows`` has the shape ``(count, dim)``, the first flow first.
        """
        return np.zeros(self.dim)

    def _correct(self, v: Array, start: Points, y: Points, end: Points, exact: Any) -> Array:
        """Return ``v``, shape ``(count, dim)``, after one step of the iteration.

        Its flow takes ``start`` to ``y``. Where ``exact``, the derivative of the flow is used in
        place of the fields at ``y``.
        """
        corrected = v + self._coefficients_at(y, end - y)
        for k in np.flatnonzero(exact):
            step = _DIFFERENCE * max(1.0, float(np.linalg.norm(v[k])))
            slopes = (self.flow(v[k] + step * np.eye(self.dim), start[k]) - y[k]) / step
            change = minimum_norm_coefficients(slopes[None], (end - y)[k, None], _DIFFERENCE_RANK)
            corrected[k] = v[k] + change[0]
        return corrected

    def _coefficients_at(self, y: Points, tangent: Points) -> Array:
        """Return the least-squares coefficients of minimum norm of tangents at ``y``.

        Points and tangents have the shape ``(count, *point_shape)``.
        """
        return minimum_norm_coefficients(self.field(np.eye(self.dim), y[:, None]), tangent)

    def coordinate_sizes(self, y: ArrayLike) -> Array:
        """Return the scale of each coordinate for relative tolerances.

        The scale of a translation of Euclidean space is the absolute value of the coordinate that
        it changes; in a semidirect product it is the length of the vector that it changes. Other
        coordinates, such as angles, have scale one.
        """
        point = self._points(y)
        return np.ones((*point.shape[: point.ndim - len(self.point_shape)], self.dim))

    def turning_coefficients(self) -> Array:
        """Return 1 for each coefficient that may turn points, 0 for those of translations."""
        return np.ones(self.dim)

    @property
    def jointed(self) -> bool:
        """Whether the frame is, or has as a factor, a phase space with joints or constraints."""
        return False

    @property
    def rhs_dim(self) -> int:
        """Number of coefficients that right-hand sides return: ``dim``, of `PhaseSpace` fewer."""
        return self.dim

    def complete_rhs(self, f: Array, y: Array) -> Array:
        """Return all coefficients, shape ``(..., dim)``, of those that right-hand sides return."""
        return f

    def for_derivatives(self) -> Frame:
        """Return the frame that moves the same points fastest along derivatives."""
        return self

    def compiled_blocks(self) -> Blocks | None:
        """Return the description of this frame for compiled code, None if there is none.

        A subclass of a compiled frame may override its flow, so it must define ``_blocks`` itself.
        """
        return self._blocks() if "_blocks" in vars(type(self)) else None

    def random_vector(self, rng: np.random.Generator, size: Size = ()) -> Array:
        """Return standard normal coefficients, shape ``(*size, dim)``."""
        size = check_random(rng, size)
        return rng.standard_normal((*size, self.dim))

    def _arguments(self, v: ArrayLike, y: ArrayLike) -> tuple[Array, Points]:
        """Return ``v`` and ``y`` as arrays whose trailing axes fit this frame."""
        return self._vectors(v), self._points(y)

    def _rows(self, v: ArrayLike, y: ArrayLike) -> tuple[Array, Points]:
        """Return ``v`` and ``y`` as contiguous arrays with the same leading axes."""
        vectors, points = self._arguments(v, y)
        leads = vectors.shape[:-1], points.shape[: points.ndim - len(self.point_shape)]
        if leads[0] != leads[1]:
            lead = np.broadcast_shapes(*leads)
            vectors = np.broadcast_to(vectors, (*lead, self.dim))
            points = np.broadcast_to(points, (*lead, *self.point_shape))
        return np.ascontiguousarray(vectors), np.ascontiguousarray(points)


class CompiledFlow(Frame):
    """A frame of one compiled block, which has no flow in Python."""

    def flow(self, v: ArrayLike, y: ArrayLike) -> Points:
        vectors, points = self._rows(v, y)
        (block,) = self._blocks() or ()
        moved = move(block, vectors, points)
        if math.isfinite(abs(moved.sum())):  # a cheap sufficient test
            return moved
        axes = tuple(range(vectors.ndim - 1, points.ndim))
        lost = ~np.isfinite(moved).all(axis=axes) & np.isfinite(points).all(axis=axes)
        lost &= np.isfinite(vectors).all(axis=-1)
        if lost.any():
            largest = np.abs(vectors[lost]).max()
            raise FlowOverflowError(
                f"the flow of v with |v| = {largest:.3g} can't be computed in double precision"
            )
        return moved


def check_frame(frame: Any, name: str = "frame") -> None:
    """Raise TypeError unless ``frame`` is a frame."""
    if not isinstance(frame, Frame):
        raise TypeError(f"{name} must be a Frame such as SO3() or Euclidean(3), got {frame!r}")


@dataclass(frozen=True, repr=False)
class SizedFrame(Frame):
    """A frame with a size n as its first parameter."""

    n: int

    min_n: ClassVar[int] = 1

    def __post_init__(self) -> None:
        object.__setattr__(self, "n", check_integer("n", self.n, self.min_n))

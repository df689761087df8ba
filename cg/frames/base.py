"""The interface of a frame: vector fields whose linear combinations have computable flows."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import MISSING, fields, is_dataclass
from numbers import Real
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from cg.frames.algebra import FieldAlgebra
from cg.frames.arrays import (
    Array,
    Points,
    Size,
    check_name,
    check_random,
    complex_array,
    is_array,
    real_array,
)
from cg.frames.block_kinds import Blocks
from cg.frames.checking import find_inconsistencies
from cg.frames.local_coordinates import (
    local_coordinates,
    minimum_norm_coefficients,
    newton_correction,
)
from cg.support.checks import check_generator

MEMBERSHIP_TOLERANCE = 1e-8

_ROTATION_HINTS = {
    (4,): "; quaternions are points of cg.frames.UnitQuaternion()",
    (3, 3): "; rotation matrices are points of cg.frames.SO3()",
}


class FlowOverflowError(OverflowError):
    """The coefficients are too large for their flow to be computed in double precision.

    Examples
    --------
    >>> import numpy as np
    >>> from cg.frames import SL
    >>> try:
    ...     SL(2).flow([1e14, 0.0, 0.0], np.eye(2))
    ... except FlowOverflowError as error:
    ...     print(str(error).partition(":")[0])
    the flow of v with |v| = 1e+14 can't be computed in double precision
    """


class Frame(FieldAlgebra):
    r"""Vector fields :math:`E_1, \dots, E_m` on a manifold embedded in arrays.

    A differential equation is written in the frame as
    :math:`y' = \sum_i f_i(t, y) E_i(y)` (equation (1.1) of [1]_), and a numerical method moves
    along flows of :math:`y' = \sum_i v_i E_i(y)` with constant :math:`v` (equation (1.2)).

    A subclass is immutable, compares by value, and defines the abstract members; integrators need
    no others.  Every method accepts single points and batches: ``v`` has shape ``(..., dim)``,
    ``y`` has shape ``(..., *point_shape)``, and leading axes broadcast.  The coefficients ``v`` are
    always real; points are real or complex, see `dtype`.

    On matrix groups the fields are invariant under one of the two multiplications, with
    :math:`\Omega(v)` in the Lie algebra: ``convention="body"`` is :math:`y' = y\,\Omega(v)`,
    ``convention="space"`` is :math:`y' = \Omega(v)\,y`.  The default is ``"body"`` for rotations
    and rigid motions (``SO3``, ``SO``, ``UnitQuaternion``, ``SE3``), since gyros measure angular
    velocities in body axes, and ``"space"`` for the other groups, since they propagate
    :math:`x' = \Omega x`.  On homogeneous spaces the group acts from the left.

    References
    ----------
    .. [1] Z. Jackiewicz, A. Marthinsen, B. Owren, "Construction of Runge-Kutta methods of
       Crouch-Grossman type of high order", Adv. Comput. Math. 13 (2000), 405-415.

    Examples
    --------
    The members that all frames have, here of unit quaternions:

    >>> import numpy as np
    >>> from cg.frames import UnitQuaternion
    >>> frame = UnitQuaternion()
    >>> frame.dim, frame.point_shape
    (3, (4,))
    >>> y = frame.random_point(np.random.default_rng(0))
    >>> moved = frame.flow([0.1, 0.2, 0.3], y)
    >>> frame.exp_coordinates(y, moved).round(12)
    array([0.1, 0.2, 0.3])
    >>> bool(frame.membership_error(moved) < 1e-15)
    True
    """

    @property
    @abstractmethod
    def dim(self) -> int:
        """Number of vector fields, the length of ``v``."""

    @property
    @abstractmethod
    def point_shape(self) -> tuple[int, ...]:
        """Shape of the array that holds one point."""

    @property
    def dtype(self) -> np.dtype[Any]:
        """Type of a point's entries: float64, or complex128."""
        return np.dtype(np.float64)

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
        ValueError
            If the trailing axes of ``v`` or ``y`` don't match ``dim`` and ``point_shape``.
        FlowOverflowError
            If ``v`` is so large that double precision has no digits of its flow.  On compact
            groups there is no such limit.
        """

    def without_isotropy(self, v: ArrayLike, y: ArrayLike) -> Array:
        """Return ``v`` without its component in the isotropy algebra of ``y``.

        The result has the same tangent at ``y`` as ``v``.  By default it is ``v``; spheres return
        the coefficients of least norm.

        Parameters
        ----------
        v
            Coefficients, shape ``(..., dim)``.
        y
            Points, shape ``(..., *point_shape)``.
        """
        return self._arguments(v, y)[0]

    @abstractmethod
    def membership_error(self, y: ArrayLike) -> Array:
        """Return the distance of ``y`` from the manifold, shape ``(...)``."""

    def relative_error(self, y: ArrayLike) -> Array:
        """Return the membership error relative to the size of the points, shape ``(...)``.

        By default it is the membership error itself, as for rotations, which have size one.
        """
        return self.membership_error(y)

    def project(self, y: ArrayLike) -> Points:
        """Return the points of the manifold that are nearest to arrays near it.

        `check_point` rejects points that were stored in single precision; their projections are
        accepted.

        Parameters
        ----------
        y
            Shape ``(..., *point_shape)``.

        Returns
        -------
        ndarray
            Of type ``dtype``, shape ``(..., *point_shape)``; NaN where the nearest point does not
            exist or is not unique, as for zero and a sphere.

        Raises
        ------
        NotImplementedError
            If the frame does not define a projection.
        """
        point = self._points(y)
        rows = point.reshape(-1, *self.point_shape)
        axes = tuple(range(1, rows.ndim))
        valid = np.asarray(np.isfinite(rows).all(axis=axes))
        projected = np.full(rows.shape, np.nan, dtype=self.dtype)
        with np.errstate(divide="ignore", over="ignore", invalid="ignore"):
            projected[valid] = self._project(rows[valid])
            valid = np.asarray(np.isfinite(projected).all(axis=axes))
            valid[valid] = self.relative_error(projected[valid]) <= MEMBERSHIP_TOLERANCE
        projected[~valid] = np.nan
        return projected.reshape(point.shape)

    def _project(self, y: Points) -> Points:
        """Return the nearest points to finite arrays, shape ``(count, *point_shape)``."""
        raise NotImplementedError(f"{self!r} has no projection onto its manifold")

    @abstractmethod
    def random_point(self, rng: np.random.Generator, size: Size = ()) -> Points:
        """Return random points, shape ``(*size, *point_shape)``.

        Parameters
        ----------
        rng
            Random generator, such as ``numpy.random.default_rng(seed)``.
        size
            The leading axes; an integer is one axis.

        Raises
        ------
        TypeError
            If ``rng`` isn't a generator, or ``size`` is neither an integer nor a sequence of them.
        ValueError
            If ``size`` is negative.
        """

    def distance(self, x: ArrayLike, y: ArrayLike) -> Array:
        """Return the distance of points, shape ``(...)``; by default the Euclidean distance."""
        difference = self._points(x, "x") - self._points(y)
        axes = tuple(range(-len(self.point_shape), 0))
        return np.asarray(np.sqrt((np.abs(difference) ** 2).sum(axis=axes)))

    def exp_coordinates(self, y0: ArrayLike, y1: ArrayLike) -> Array | None:
        """Return the coefficients of least norm whose flow takes ``y0`` to ``y1``.

        Parameters
        ----------
        y0, y1
            Points, shape ``(..., *point_shape)``.

        Returns
        -------
        ndarray or None
            ``v`` with ``flow(v, y0) == y1``, shape ``(..., dim)``, NaN where there is none.
            None if the frame does not define this map; see `local_coordinates`.
        """
        self._points(y0, "y0")
        self._points(y1, "y1")
        return None

    def local_coordinates(self, y0: ArrayLike, y1: ArrayLike) -> Array:
        r"""Return coefficients whose flow takes ``y0`` to a point ``y1`` near it.

        Every frame has them.  The Gauss-Newton iteration

        .. math::

            v \leftarrow v + E(y)^+ (y_1 - y), \qquad y = \exp(\textstyle\sum_i v_i E_i) y_0 ,

        with the matrix :math:`E(y)` of the fields, starts from `exp_coordinates` where these are
        defined, from zero elsewhere, and ends when the residual is rounding.

        Parameters
        ----------
        y0, y1
            Points, shape ``(..., *point_shape)``.

        Returns
        -------
        ndarray
            ``v`` with ``flow(v, y0) == y1`` to rounding, shape ``(..., dim)``; zero where the
            points are equal, NaN where the iteration fails for points too far apart.
        """
        start, end = np.broadcast_arrays(self._points(y0, "y0"), self._points(y1, "y1"))
        lead = start.shape[: start.ndim - len(self.point_shape)]
        guess = self.exp_coordinates(start, end)
        start, end = (y.reshape(-1, *self.point_shape) for y in (start, end))
        v = np.zeros((len(start), self.dim)) if guess is None else guess.reshape(-1, self.dim)
        return local_coordinates(self, v, start, end).reshape(*lead, self.dim)

    def _correct(self, v: Array, start: Points, y: Points, end: Points, exact: Any) -> Array:
        """Return the coefficients after one step of the iteration in `local_coordinates`.

        Parameters
        ----------
        v
            Coefficients whose flow takes ``start`` to ``y``, shape ``(count, dim)``.
        start, y, end
            Shape ``(count, *point_shape)``.
        exact
            Whether to use the derivative of the flow in place of the fields at its end point, shape
            ``(count,)``.
        """
        corrected = v + self._coefficients_at(y, end - y)
        for k in np.flatnonzero(exact):
            corrected[k] = newton_correction(self, v[k], start[k], y[k], end[k])
        return corrected

    def _coefficients_at(self, y: Points, tangent: Points) -> Array:
        """Return the least-squares coefficients of minimum norm of a tangent at ``y``.

        Parameters
        ----------
        y, tangent
            Shape ``(count, *point_shape)``.
        """
        return minimum_norm_coefficients(self.field(np.eye(self.dim), y[:, None]), tangent)

    def coordinate_sizes(self, y: ArrayLike) -> Array:
        """Return the scale of each coordinate for relative tolerances.

        The scale of a translation of Euclidean space is the absolute value of the coordinate that
        it changes; in a semidirect product it is the length of the vector that it changes.  Other
        coordinates, such as angles, have scale one.

        Parameters
        ----------
        y
            Points, shape ``(..., *point_shape)``.

        Returns
        -------
        ndarray
            Shape ``(..., dim)``.
        """
        point = self._points(y)
        return np.ones((*point.shape[: point.ndim - len(self.point_shape)], self.dim))

    def compiled_blocks(self) -> Blocks | None:
        """Return the description of this frame for compiled code, None if there is none.

        A subclass of a compiled frame may override its flow, so it must define ``_blocks`` itself.
        """
        return self._blocks() if "_blocks" in vars(type(self)) else None

    def _blocks(self) -> Blocks | None:
        """Return the blocks of an instance of exactly this class; compiled frames define it."""
        return None

    def random_vector(self, rng: np.random.Generator, size: Size = ()) -> Array:
        """Return standard normal coefficients, shape ``(*size, dim)``."""
        size = check_random(rng, size)
        return rng.standard_normal((*size, self.dim))

    def read_points(self, value: Any, name: str = "y") -> Points:
        """Convert points to a new C-ordered array of type ``dtype``.

        Some frames also accept other representations, such as ``Rotation`` of SciPy.

        Parameters
        ----------
        value
            Points; neither the shape nor the membership is checked.
        name
            Name of the argument in error messages.

        Raises
        ------
        ValueError
            If it isn't numeric (real, unless points are complex).
        TypeError
            If ``name`` isn't a string.
        """
        check_name(name)
        return (real_array if self.dtype.kind == "f" else complex_array)(value, name)

    def check_point(
        self, y: ArrayLike, *, tolerance: float = MEMBERSHIP_TOLERANCE, name: str = "y"
    ) -> Points:
        """Return ``y`` as a new array of type ``dtype`` after checking that it is one point.

        Parameters
        ----------
        y
            The candidate, shape ``point_shape``.
        tolerance
            Largest accepted `relative_error`.
        name
            Name of the argument in error messages.

        Raises
        ------
        ValueError
            If ``y`` isn't numeric (real, unless points are complex), has another shape, is not
            finite or lies off the manifold, or if ``tolerance`` is negative or not a number.
        TypeError
            If ``name`` isn't a string.
        """
        check_name(name)
        if isinstance(tolerance, bool) or not isinstance(tolerance, Real) or not tolerance >= 0.0:
            raise ValueError(f"tolerance must be a non-negative number, got {tolerance!r}")
        point = self.read_points(y, name)
        if point.shape != self.point_shape:
            hint = _ROTATION_HINTS.get(point.shape, "") if self._rotation_sign else ""
            raise ValueError(f"{name} must have shape {self.point_shape}, got {point.shape}{hint}")
        if not np.isfinite(point).all():
            raise ValueError(f"{name} must be finite, got {point}")
        error = float(self.relative_error(point))
        if not error <= tolerance:
            relative = "" if error == self.membership_error(point) else "relative "
            raise ValueError(
                f"{name} must be a point of {self}: its {relative}distance from the manifold is "
                f"{error:.3g}, more than {tolerance:.3g}{self._projection_hint(point, name)}"
            )
        return point

    def _projection_hint(self, point: Points, name: str) -> str:
        """Return a hint to use `project`, for the message about a point off the manifold."""
        try:
            nearest = self.project(point)
        except NotImplementedError:
            return ""
        if not np.isfinite(nearest).all() or self.relative_error(nearest) > MEMBERSHIP_TOLERANCE:
            return ""
        argument = name.partition("[")[0]
        return f"; frame.project({argument}) is the nearest point"

    def check(
        self, *, rng: np.random.Generator | None = None, points: ArrayLike | None = None
    ) -> None:
        r"""Check that the methods of this frame are consistent with each other.

        At random points and with random coefficients it checks that ``flow(0, y)`` is ``y``, that
        flows along one field compose, that the derivative of the flow is `field`, that
        `exp_coordinates` and `local_coordinates` invert the flow, that `bracket` is the commutator
        of the fields, that `dexpinv` agrees with derivatives of flows, and that flows stay on the
        manifold.  It computes some hundred flows.

        Parameters
        ----------
        rng
            Random generator for points and coefficients, by default
            ``numpy.random.default_rng(0)``.
        points
            Points to check at, shape ``(count, *point_shape)``, by default three of
            `random_point`.

        Raises
        ------
        ValueError
            If a check fails, or if ``points`` aren't points; the message lists all failed checks.
        TypeError
            If ``rng`` isn't a generator.
        NotImplementedError
            If ``points`` is None and the frame has no `random_point`.

        Examples
        --------
        A flow with the wrong sign, which an integration would not reveal:

        >>> import numpy as np
        >>> from cg.frames import FieldFrame
        >>> frame = FieldFrame(
        ...     [lambda y: np.array([y[0], -y[1]])],
        ...     lambda v, y: np.array([y[0] * np.exp(-v[0]), y[1] * np.exp(v[0])]),
        ...     point_shape=2,
        ... )
        >>> try:
        ...     frame.check()
        ... except ValueError as error:
        ...     print(str(error).partition(" (")[0])
        frame is inconsistent: flow has the wrong sign: its derivative is -field(v, y)
        """
        rng = np.random.default_rng(0) if rng is None else check_generator("rng", rng)
        if points is None:
            chosen = self.random_point(rng, 3)
        else:
            chosen = self.read_points(points, "points")
            if chosen.shape[1:] != self.point_shape or len(chosen) == 0:
                shape = ", ".join(map(str, ("count", *self.point_shape)))
                raise ValueError(f"points must have shape ({shape}), got {chosen.shape}")
        problems = find_inconsistencies(self, chosen, rng)
        if problems:
            raise ValueError(f"frame is inconsistent: {'; '.join(problems)}")

    def _arguments(self, v: ArrayLike, y: ArrayLike) -> tuple[Array, Points]:
        """Return ``v`` and ``y`` as arrays whose trailing axes fit this frame."""
        return self._vectors(v), self._points(y)

    def _points(self, y: ArrayLike, name: str = "y") -> Points:
        """Return ``y`` as an array of type ``dtype`` whose trailing axes are ``point_shape``."""
        points: Points = y if is_array(y, self.dtype) else self.read_points(y, name)
        shape = self.point_shape
        if points.shape[max(points.ndim - len(shape), 0) :] != shape:
            axes = ", ".join(map(str, shape))
            raise ValueError(f"{name} must have shape (..., {axes}), got {points.shape}")
        return points

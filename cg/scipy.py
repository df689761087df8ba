"""Solvers for ``method=`` of `scipy.integrate.solve_ivp`, and for other hosts of such classes."""

from __future__ import annotations

import math
from os import PathLike
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike
from scipy.integrate import DenseOutput, OdeSolver

from cg.frames.base import Frame, check_frame
from cg.frames.euclidean import Euclidean
from cg.frames.linear_action import LinearAction
from cg.frames.product import Power, Product
from cg.integration.default_method import AUTO, choose_method
from cg.integration.stepper import Stepper
from cg.support.arrays import Array, Points, real_array
from cg.support.checks import check_real, warn_user
from cg.tables import HasTable, table_of


def Solver(frame: Frame, method: str | PathLike[str] | HasTable = AUTO) -> type[OdeSolver]:
    """Return a solver on a manifold, for ``method=`` of `scipy.integrate.solve_ivp`.

    It takes functions that return derivatives as they are, and keeps all points on the manifold,
    those between steps too. Points are vectors, as everywhere in SciPy: the entries of a matrix row
    by row. Other programs that take a class derived from `scipy.integrate.OdeSolver` take it too,
    change its ``y`` and ``t_bound`` between steps, and go on.

    Parameters
    ----------
    frame
        The frame of the points; a quaternion in a longer vector is a factor of a
        `cg.frames.Product`.
    method
        As for `cg.solve_ivp`. By default ``"CF5(4)"`` for ``rtol`` of 1e-4 and more, since
        functions of hosts have kinks, where it takes 0.6 times the evaluations.

    Returns
    -------
    type
        A class with the options ``rtol``, ``atol``, ``max_step``, ``first_step`` and
        ``max_angle``. Tolerances of each entry of the point become those of coordinates: of a
        factor other than Euclidean space the smallest one. No step is longer than the time in which
        a rotation with the velocity at its start turns by ``max_angle``, by default π/2: the host
        looks for events by their signs at the ends of steps, and some steps would be many turns.

    Raises
    ------
    TypeError
        If ``frame`` isn't a frame.

    Warns
    -----
    UserWarning
        By the solver for options that it doesn't have, such as ``jac`` and ``min_step``; and, once,
        if derivatives have a part that no field has, which is dropped.

    Examples
    --------
    >>> import numpy as np
    >>> from scipy.integrate import solve_ivp
    >>> import crouch_grossman as cg
    >>> def f(t, q):
    ...     x, y, z, w = q
    ...     return 0.5 * np.array([y * t + w, -x * t + z, w * t - y, -x - z * t])
    >>> method = cg.scipy.Solver(cg.frames.UnitQuaternion())
    >>> run = solve_ivp(f, (0, 20), [0, 0, 0, 1], method=method)
    >>> bool(np.abs(np.linalg.norm(run.y, axis=0) - 1).max() < 1e-15)
    True
    """
    check_frame(frame)
    if method != AUTO:
        table_of(method)  # an error for a wrong name comes here
    members = {"frame": frame, "method": method, "__module__": __name__}
    return type("Solver", (FrameSolver,), members)


class FrameSolver(OdeSolver):
    """A solver on the frame of a subclass."""

    frame: ClassVar[Frame]
    method: ClassVar[Any]

    def __init__(
        self, fun: Any, t0: float, y0: ArrayLike, t_bound: float, max_step: float = math.inf,
        rtol: ArrayLike = 1e-3, atol: ArrayLike = 1e-6, vectorized: bool = False,
        first_step: float | None = None, max_angle: float = 0.5 * math.pi, **extraneous: Any,
    ) -> None:  # fmt: skip
        if extraneous:
            warn_user(f"options without effect: {', '.join(extraneous)}")
        frame = self.frame
        is_complex = frame.dtype.kind == "c"
        given: Any = np.asarray(y0, dtype=complex) if is_complex else y0
        super().__init__(fun, t0, given, t_bound, vectorized, support_complex=is_complex)
        if self.n != math.prod(frame.point_shape):
            raise ValueError(
                f"y0 must be the {math.prod(frame.point_shape)} entries of a point of {frame!r}, "
                f"got {self.n}"
            )
        if first_step is not None:
            first_step = check_real("first_step", first_step, positive=True)
            if first_step > abs(t_bound - t0):
                raise ValueError(f"first_step must be within t_span, got {first_step!r}")
        self._max_angle = check_real("max_angle", max_angle, positive=True, infinite=True)
        self._start: tuple[float, Points, Points] | None = None  # t, y and derivative
        method = self.method
        relative = self._tolerances(rtol, "rtol")
        if isinstance(method, str) and method == AUTO:
            method = choose_method(frame.for_derivatives(), float(relative.max()), kinks=True)
        self._stepper = Stepper(
            self._derivative, t0, self.y.reshape(frame.point_shape), self.direction * math.inf,
            frame=frame, method=method, rhs="derivative", max_step=max_step,
            first_step=first_step, rtol=relative,
            atol=self._tolerances(atol, "atol"),
        )  # fmt: skip
        self._reached = self.y.copy()

    def _derivative(self, t: float, y: Points) -> Points:
        if self._start is not None and t == self._start[0] and np.array_equal(y, self._start[1]):
            return self._start[2]
        slope = np.asarray(self.fun(t, np.array(y).reshape(-1)))
        if slope.size != self.n:
            raise ValueError(f"fun must return {self.n} numbers, got shape {slope.shape}")
        return slope.reshape(self.frame.point_shape)

    def _tolerances(self, given: ArrayLike, name: str) -> Array:
        """Return tolerances in the form of `cg.solve_ivp` for those of entries of a point."""
        tolerances = real_array(given, name)
        if tolerances.ndim == 0:
            return tolerances
        frame, shape = self.frame, self.frame.point_shape
        if tolerances.shape != (self.n,):
            raise ValueError(f"{name} must be a number or {self.n} numbers, got {given!r}")
        point, entries = self.y.reshape(shape), tolerances.reshape(shape)
        if frame.exp_coordinates(point, point) is None:
            return entries
        return _of_coordinates(frame, entries)

    def _step_impl(self) -> tuple[bool, str | None]:
        stepper = self._stepper
        moved = self.t != stepper.t
        if moved or not np.array_equal(self.y, self._reached):
            if np.size(self.y) != self.n:
                raise ValueError(f"y must be {self.n} numbers, got shape {np.shape(self.y)}")
            y = np.reshape(self.y, self.frame.point_shape)
            stepper.restart(t=self.t if moved else None, y=y)
        if (self.t_bound - self.t) * self.direction < 0.0:
            raise ValueError(
                f"t_bound must not lie before t = {self.t:.17g}, got {self.t_bound:.17g}"
            )
        message = stepper.step(self._bound())
        self._start = None
        self.njev, self.nlu = stepper.njev, stepper.nlu
        self._reached = stepper.y.reshape(-1)
        self.t, self.y = stepper.t, self._reached.copy()
        return message is None, message

    def _bound(self) -> float | None:
        """Return the end of the longest step, None if there is none."""
        bound = self.t_bound
        if math.isfinite(self._max_angle):
            t, y = self._stepper.t, self._stepper.y
            self._start = t, y, self._derivative(t, y)
            v = self.frame._coefficients_at(y[None], self._start[2][None])[0]
            rate = _turning_rate(self.frame, v)
            if rate * abs(bound - t) > self._max_angle:
                bound = t + self.direction * max(self._max_angle / rate, math.ulp(t))
        return None if math.isinf(bound) else bound

    def _dense_output_impl(self) -> DenseOutput:
        return _Step(self.t_old, self.t, self._stepper.dense_output(), self.frame)


class _Step(DenseOutput):
    """The solution in a step; beyond its ends coordinates of three of its points go on."""

    def __init__(self, t_old: float, t: float, output: Any, frame: Frame) -> None:
        super().__init__(t_old, t)
        self._output, self._frame = output, frame

    def _call_impl(self, t: Array) -> Points:
        inside = np.clip(t, self.t_min, self.t_max)
        points = self._output(inside)
        if (beyond := t - inside).any():
            length = self.t - self.t_old
            *before, last = self._output([self.t_old, self.t_old + 0.5 * length, self.t])
            start, middle = self._frame.local_coordinates(last, np.array(before))
            square = 2.0 * start - 4.0 * middle
            s = ((t - self.t) / length)[..., None]
            moved = self._frame.flow(s * (square - start) + s**2 * square, last)
            is_beyond = (beyond != 0.0).reshape(*t.shape, *(1,) * last.ndim)
            points = np.where(is_beyond, moved, points)
        rows: Points = points.reshape(*t.shape, -1)
        return rows.T


def _turning_rate(frame: Frame, v: Array) -> float:
    """Return the largest norm of coefficients of a factor with rotations or the like."""
    if isinstance(frame, LinearAction):
        return 0.0
    if isinstance(frame, Power):
        return max(_turning_rate(frame.factor, part) for part in frame._split_vector(v))
    if isinstance(frame, Product):
        return max(map(_turning_rate, frame.factors, frame._split_vector(v)))
    return float(np.linalg.norm(v * frame.turning_coefficients()))


def _of_coordinates(frame: Frame, tolerances: Array) -> Array:
    """Return tolerances of coordinates for tolerances of the entries of points."""
    if isinstance(frame, Euclidean):
        return tolerances
    if isinstance(frame, Product):
        each = zip(frame.factors, frame.split(tolerances), strict=True)
        return np.concatenate([_of_coordinates(factor, part) for factor, part in each])
    if isinstance(frame, Power):
        return np.concatenate([_of_coordinates(frame.factor, part) for part in tolerances])
    return np.full(frame.dim, tolerances.view(np.float64).min())  # also of imaginary parts

"""Explicit Crouch-Grossman methods with a fixed step."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from numbers import Real
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from cg.frames.base import Array, Frame, real_array
from cg.tableau import Tableau

Coefficients = Callable[[float, Array], ArrayLike]

# A step number must be an exact float, or the times would not be distinct.
_MOST_STEPS = 2**53


@dataclass(frozen=True)
class Trajectory:
    """A numerical solution.

    Attributes
    ----------
    t
        Times, shape ``(steps + 1,)``, read-only.
    y
        Points, shape ``(steps + 1, *point_shape)``, read-only.
    nfev
        Number of evaluations of the coefficients.
    nexp
        Number of flows (exponentials) that were computed.
    method
        The tableau that was used.
    h
        Absolute size of all steps but perhaps the last.
    """

    t: Array
    y: Array
    nfev: int
    nexp: int
    method: Tableau
    h: float

    def __repr__(self) -> str:
        return (
            f"Trajectory(t={self.t[0]:g}...{self.t[-1]:g}, steps={len(self.t) - 1}, "
            f"nfev={self.nfev}, nexp={self.nexp}, h={self.h:g})"
        )


def integrate(
    f: Coefficients,
    t_span: Sequence[float],
    y0: ArrayLike,
    *,
    frame: Frame,
    method: str | Tableau,
    h: float,
) -> Trajectory:
    r"""Integrate :math:`y' = \sum_i f_i(t, y) E_i(y)` by an explicit method with a fixed step.

    One step from :math:`p = y_k` is equation (2.2) of [1]_: with :math:`F_j` the vector field
    whose coefficients are frozen at stage :math:`j`,

    .. math::

        Y_i = e^{h a_{i,i-1} F_{i-1}} \cdots e^{h a_{i1} F_1} p, \qquad
        y_{k+1} = e^{h b_s F_s} \cdots e^{h b_1 F_1} p .

    The flow of the lowest stage is applied first, the coefficients of stage :math:`i` are taken
    at :math:`t_k + c_i h`, and a coefficient that is exactly zero costs no flow.

    Parameters
    ----------
    f
        ``f(t, y)`` returns the coefficients, shape ``(frame.dim,)``.  It is given a read-only
        ``y`` of shape ``frame.point_shape``.  An exception that it raises ends the call.
    t_span
        Initial and final time.  If the final time is smaller, integration runs backward.
    y0
        Initial point, shape ``frame.point_shape``.
    frame
        The frame that holds the points and supplies the flows.
    method
        Name of a method of the catalogue, or a tableau.
    h
        Step size, positive whatever the direction.  If it doesn't divide the span, the last
        step is shorter.

    Returns
    -------
    Trajectory

    Raises
    ------
    TypeError
        If ``f`` isn't callable, ``frame`` isn't a `Frame`, ``method`` is neither a name nor a
        tableau, or ``h`` isn't a real number.
    ValueError
        If ``t_span``, ``y0``, ``method`` or ``h`` has an impossible value, or if ``f`` returns
        another shape or numbers that aren't finite.
    OverflowError
        If the solution exceeds the range of floating point.

    References
    ----------
    .. [1] Z. Jackiewicz, A. Marthinsen, B. Owren, "Construction of Runge-Kutta methods of
       Crouch-Grossman type of high order", Adv. Comput. Math. 13 (2000), 405-415.

    Examples
    --------
    A rotation about a fixed body axis is solved exactly by any method.

    >>> import numpy as np
    >>> from cg.frames import SO3
    >>> from cg.integrate import integrate
    >>> turn = lambda t, y: [0.0, 0.0, np.pi / 2]
    >>> solution = integrate(turn, (0, 1), np.eye(3), frame=SO3(), method="CG3", h=0.25)
    >>> solution.y[-1].round(12)[:, 0]
    array([0., 1., 0.])
    """
    if not callable(f):
        raise TypeError(f"f must be callable as f(t, y), got {f!r}")
    if not isinstance(frame, Frame):
        raise TypeError(f"frame must be a Frame such as SO3(), got {frame!r}")
    tableau = resolve_method(method)
    if not tableau.explicit:
        raise ValueError(f"method must be explicit, got the implicit {method!r}")
    times = time_grid(t_span, h)
    point = frame.check_point(y0, name="y0")

    step = _Step(f, frame, tableau)
    steps = len(times) - 1
    points = np.empty((steps + 1, *frame.point_shape))
    points[0] = point
    # Full steps take h itself, not differences of rounded times, so that all are equal.
    sizes = [math.copysign(float(h), times[-1] - times[0])] * steps
    if sizes:
        sizes[-1] = _last_step(float(times[-2]), float(times[-1]), sizes[-1])
    for k, (t, size) in enumerate(zip(times.tolist(), sizes, strict=False)):
        point = step(t, point, size)
        if not np.isfinite(point).all():
            raise OverflowError(f"the solution is no longer finite at t = {times[k + 1]:.17g}")
        points[k + 1] = point
    times.flags.writeable = points.flags.writeable = False
    return Trajectory(times, points, steps * step.nfev, steps * step.nexp, tableau, float(h))


def resolve_method(method: str | Tableau) -> Tableau:
    """Return the tableau that ``method`` is or names.

    Parameters
    ----------
    method
        A tableau, or the name of one in the catalogue.

    Returns
    -------
    Tableau

    Raises
    ------
    ValueError
        If no method of the catalogue has that name; the message lists those there are.
    TypeError
        If ``method`` is neither a name nor a tableau.
    """
    if isinstance(method, Tableau):
        return method
    if not isinstance(method, str):
        raise TypeError(f"method must be a name or a Tableau, got {method!r}")
    from cg.catalogue import methods

    if method not in methods:
        raise ValueError(f"method must be one of {', '.join(methods)}, got {method!r}")
    return methods[method]


def time_grid(t_span: Sequence[float], h: float) -> Array:
    """Return the times of a fixed-step integration.

    Parameters
    ----------
    t_span
        Initial and final time.
    h
        Step size, positive.

    Returns
    -------
    ndarray
        Shape ``(steps + 1,)``.  It starts and ends with ``t_span``; all steps have length ``h``
        except that the last may be shorter.

    Raises
    ------
    TypeError
        If ``h`` isn't a real number.
    ValueError
        If ``t_span`` isn't two finite numbers, or ``h`` isn't positive and finite, or so small
        that the times can't be told apart.
    """
    try:
        start, stop = (float(t) for t in t_span)
    except (TypeError, ValueError) as error:
        raise ValueError(f"t_span must be two numbers, got {t_span!r}") from error
    if not (math.isfinite(start) and math.isfinite(stop)):
        raise ValueError(f"t_span must be finite, got {t_span!r}")
    if isinstance(h, bool) or not isinstance(h, Real):
        raise TypeError(f"h must be a real number, got {h!r}")
    size = float(h)
    if not (math.isfinite(size) and size > 0.0):
        raise ValueError(f"h must be positive and finite, got {h!r}")
    span = abs(stop - start)
    if not math.isfinite(span):
        raise ValueError(f"t_span must have a finite length, got {t_span!r}")
    if span == 0.0:
        return np.array([start])
    largest = max(abs(start), abs(stop))
    ratio = span / size
    if ratio > _MOST_STEPS or (ratio > 1.0 and size < math.ulp(largest)):
        raise ValueError(f"h is too small for t_span {t_span!r}: its times coincide, got {h!r}")
    # The ratio carries the rounding of the two ends and of h.  Within that, h divides the span.
    nearest = round(ratio)
    slack = 2.0 * (math.ulp(largest) / size + math.ulp(ratio))
    steps = max(1, nearest if abs(ratio - nearest) <= slack else math.ceil(ratio))
    times = start + math.copysign(size, stop - start) * np.arange(steps + 1)
    times[-1] = stop
    return times


def _last_step(t: float, stop: float, h: float) -> float:
    """Return ``h`` if it leads from ``t`` to ``stop`` up to rounding, else the shorter rest."""
    rest = stop - t
    slack = 4.0 * (math.ulp(max(abs(t), abs(stop))) + math.ulp(h))
    return h if abs(rest - h) <= slack else rest


class _Step:
    """One step (2.2) of a tableau, prepared for many repetitions."""

    def __init__(self, f: Coefficients, frame: Frame, tableau: Tableau) -> None:
        self.f = f
        self.frame = frame
        self.abscissae = tableau.c.tolist()
        self.rows = [_nonzero(row[:i]) for i, row in enumerate(tableau.a)]
        self.weights = _nonzero(tableau.b)
        self.nfev = tableau.stages
        self.nexp = sum(map(len, self.rows)) + len(self.weights)

    def __call__(self, t: float, point: Array, h: float) -> Array:
        fields: list[Array] = []
        for c, row in zip(self.abscissae, self.rows, strict=True):
            fields.append(self.evaluate(t + c * h, self.compose(row, fields, point, h)))
        return self.compose(self.weights, fields, point, h)

    def compose(
        self, row: list[tuple[int, float]], fields: list[Array], point: Array, h: float
    ) -> Array:
        """Apply the flows of a row of coefficients, that of the lowest stage first."""
        for j, coefficient in row:
            point = self.frame.flow(h * coefficient * fields[j], point)
        return point

    def evaluate(self, t: float, point: Array) -> Array:
        """Return f(t, point) after checking it."""
        visible = point.view()
        visible.flags.writeable = False
        value: Any = self.f(t, visible)
        try:
            # This copies, since f may return the same buffer each time.
            coefficients = real_array(value, "f")
        except ValueError as error:
            raise ValueError(
                f"f must return {self.frame.dim} real numbers, got {value!r} at t = {t:.17g}"
            ) from error
        if coefficients.shape != (self.frame.dim,):
            raise ValueError(
                f"f must return an array of shape ({self.frame.dim},), "
                f"got shape {coefficients.shape} at t = {t:.17g}"
            )
        if not np.isfinite(coefficients).all():
            if not np.isfinite(point).all():
                raise OverflowError(f"a stage is no longer finite at t = {t:.17g}")
            raise ValueError(f"f must return finite numbers, got {coefficients} at t = {t:.17g}")
        return coefficients


def _nonzero(row: Array) -> list[tuple[int, float]]:
    return [(j, value) for j, value in enumerate(row.tolist()) if value != 0.0]

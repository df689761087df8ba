"""Attitude from sampled gyro data."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import scipy
from numpy.typing import ArrayLike

from cg.frames import UnitQuaternion
from cg.frames.arrays import Array, check_finite, real_array
from cg.problems.checks import number, times_array


@dataclass(frozen=True, eq=False)
class GyroAttitude:
    r"""The attitude of a body from samples of its angular velocity by a gyro.

    .. math:: q' = \tfrac12\, q \otimes \omega(t)

    with the cubic spline :math:`\omega` through the samples (not-a-knot at the ends) and the
    unit quaternion :math:`q`, scalar last.  The interpolation error is of order four in the
    sampling interval.

    Parameters
    ----------
    times
        Increasing sampling times (s), at least four, shape ``(n,)``.
    rates
        Angular velocities in body axes (rad/s), shape ``(n, 3)``.
    initial
        The attitude at the first of the times, shape ``(4,)``.

    Raises
    ------
    ValueError
        If an argument isn't finite or has another shape, the times don't increase, or
        ``initial`` isn't a unit quaternion.

    Examples
    --------
    >>> import numpy as np
    >>> import cg
    >>> times = np.linspace(0, 1, 101)
    >>> problem = GyroAttitude(times, np.column_stack([np.cos(times), 0 * times, np.sin(times)]))
    >>> run = cg.solve_ivp(problem.f, problem.t_span, problem.y0, frame=problem.frame, rtol=1e-8)
    >>> run.y[-1].round(6)
    array([ 0.403129, -0.038648,  0.22023 ,  0.887408])
    """

    times: ArrayLike
    rates: ArrayLike
    initial: ArrayLike = (0.0, 0.0, 0.0, 1.0)
    _spline: scipy.interpolate.CubicSpline = field(init=False, repr=False)
    _span: tuple[float, float] = field(init=False, repr=False)
    _margins: tuple[float, float] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        times, rates = real_array(self.times, "times"), real_array(self.rates, "rates")
        if times.ndim != 1 or len(times) < 4 or not np.isfinite(times).all():
            raise ValueError(f"times must be at least four finite numbers, got {self.times!r}")
        if not (np.diff(times) > 0.0).all():
            raise ValueError(f"times must increase, got {self.times!r}")
        if rates.shape != (len(times), 3):
            raise ValueError(f"rates must have shape ({len(times)}, 3), got {rates.shape}")
        check_finite(rates, "rates")
        point = self.frame.check_point(self.initial, name="initial")
        for name, value in (("times", times), ("rates", rates), ("initial", point)):
            value.flags.writeable = False
            object.__setattr__(self, name, value)
        object.__setattr__(self, "_span", (float(times[0]), float(times[-1])))
        object.__setattr__(self, "_margins", (times[1] - times[0], times[-1] - times[-2]))
        try:
            spline = scipy.interpolate.CubicSpline(times, rates)
        except ValueError:  # the slopes overflow
            raise ValueError("rates must have differences that are finite") from None
        object.__setattr__(self, "_spline", spline)

    @property
    def frame(self) -> UnitQuaternion:
        """``UnitQuaternion()``."""
        return UnitQuaternion()

    @property
    def y0(self) -> Array:
        """The attitude at the first of the times, shape ``(4,)``."""
        return np.asarray(self.initial)

    @property
    def t_span(self) -> tuple[float, float]:
        """The first and the last of the times (s)."""
        return self._span

    def f(self, t: float, y: Array) -> Array:
        """Return the interpolated angular velocity, shape ``(3,)``.

        Abscissae of a method may lie outside a step, so the spline is extrapolated by up to one
        sampling interval at either end.

        Raises
        ------
        ValueError
            If ``t`` is further outside the samples.
        """
        start, stop = self._span
        first, last = self._margins
        if not start - first <= t <= stop + last:
            raise ValueError(f"t must lie between {start:g} and {stop:g}, got {t!r}")
        return np.asarray(self._spline(t))

    def invariants(self, y: ArrayLike) -> dict[str, Array]:
        """Return the length of the quaternion, shape ``(...)``, the only invariant."""
        return {"length": np.asarray(np.linalg.norm(self.frame._points(y), axis=-1))}


@dataclass(frozen=True)
class ConingMotion:
    r"""Coning motion, the classical test of attitude integration from gyro data.

    With the rotations :math:`R_1, R_3` about the first and the third axis,
    :math:`R(t) = R_3(\alpha t)\, R_1(\theta)\, R_3(\beta t)`.

    Parameters
    ----------
    precession, spin
        :math:`\alpha` and :math:`\beta` (rad/s).
    angle
        :math:`\theta`, half the aperture of the cone (rad).

    Raises
    ------
    ValueError
        If a parameter isn't a finite number.

    References
    ----------
    .. [1] P. G. Savage, "Strapdown inertial navigation integration algorithm design part 1:
       attitude algorithms", J. Guidance Control Dyn. 21 (1998), 19-28.

    Examples
    --------
    >>> import numpy as np
    >>> import cg
    >>> motion = ConingMotion()
    >>> problem = motion.sampled(np.linspace(0, 2, 201))
    >>> run = cg.solve_ivp(problem.f, problem.t_span, problem.y0, frame=problem.frame, rtol=1e-10)
    >>> bool(problem.frame.distance(run.y[-1], motion.attitude(2.0)) < 1e-7)
    True
    """

    precession: float = 3.0
    spin: float = -2.5
    angle: float = 0.5

    def __post_init__(self) -> None:
        for name in ("precession", "spin", "angle"):
            object.__setattr__(self, name, number(getattr(self, name), name))

    def rate(self, t: ArrayLike) -> Array:
        """Return the angular velocity in body axes (rad/s), shape ``(..., 3)``."""
        times = times_array(t)
        across = self.precession * np.sin(self.angle)
        along = self.spin + self.precession * np.cos(self.angle)
        return np.stack(
            [
                across * np.sin(self.spin * times),
                across * np.cos(self.spin * times),
                np.full_like(times, along),
            ],
            axis=-1,
        )

    def attitude(self, t: ArrayLike) -> Array:
        """Return the exact attitude as unit quaternions, scalar last, shape ``(..., 4)``."""
        times = times_array(t)
        total = 0.5 * (self.precession + self.spin) * times
        difference = 0.5 * (self.precession - self.spin) * times
        sine, cosine = np.sin(0.5 * self.angle), np.cos(0.5 * self.angle)
        return np.stack(
            [
                sine * np.cos(difference),
                sine * np.sin(difference),
                cosine * np.sin(total),
                cosine * np.cos(total),
            ],
            axis=-1,
        )

    def sampled(self, times: ArrayLike) -> GyroAttitude:
        """Return the problem for samples of this motion at given times.

        Raises
        ------
        ValueError
            If the times aren't at least four increasing finite numbers.
        """
        t = times_array(times)
        if t.ndim != 1 or len(t) < 4:
            raise ValueError(f"times must be at least four finite numbers, got {times!r}")
        return GyroAttitude(t, self.rate(t), self.attitude(t[0]))

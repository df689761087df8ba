"""The phase space of a mechanical system: configurations with momenta."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cg.frames.base import Frame, check_frame
from cg.frames.euclidean import Euclidean
from cg.frames.inertia import Body, Inertia, compiled_bodies, hashable, read_inertia, rows_times
from cg.frames.joints import Joint, Linkage, read_constraints, read_joints
from cg.frames.product import Product
from cg.support.arrays import Array, Points, Size, check_random, real_array
from cg.support.caches import cached_by_value
from cg.support.checks import check_generator, check_real

_ALONG = 1e-2  # part of a momentum along its point of a sphere that may be an error of steps
_TRIES = 200  # attempts to close the joints of random points


@dataclass(frozen=True, init=False, repr=False)
class PhaseSpace(Product):
    r"""Configurations of a frame with momenta, for mechanical systems.

    With the fields :math:`E_i` of the configuration, velocities :math:`\omega` and momenta
    :math:`\mu = J \omega` the equations are

    .. math::

        q' = \sum_i \omega_i E_i(q), \qquad
        \mu_i' = \langle\mu, [e_i, \omega]\rangle + \tau_i ,

    where the bracket is that of the configuration; in body axes of a rotation the first term is
    :math:`\mu \times \omega`. A right-hand side ``f(t, y)`` returns the generalised forces
    :math:`\tau` alone, shape ``(configuration.dim,)``: :math:`\tau_i = -E_i V` if they have a
    potential V. The rest is known from the inertia J. A compiled ``f`` writes as many numbers.

    The frame itself is the product of the configuration and of the Euclidean space of momenta,
    with all their coefficients.

    Parameters
    ----------
    frame
        The configuration: ``SO3``, ``SO``, ``UnitQuaternion``, ``SU``, ``U``, ``Euclidean``,
        ``Sphere(2)``, and products and powers of them.
    inertia
        A matrix of shape ``(dim, dim)``, or its diagonal, or a multiple of the identity as a
        number, by default the identity. Of a product a tuple, one for each factor; of a power of n
        that of all factors, or one for each, shape ``(n, 1)``, ``(n, dim)`` or ``(n, dim, dim)``;
        ``(dim, dim)`` is one matrix, which is refused for n = dim. On Euclidean space it may be any
        positive definite one, and on rotations of space in body axes, also one without a body,
        whose largest moment exceeds the sum of the others. On other groups, on spheres and in space
        axes it is a multiple of the identity.
    gyroscopic
        A force that is linear in the velocity and does no work, :math:`B \omega` with an
        antisymmetric matrix B of shape ``(dim, dim)``, which is added to the others: that of a
        magnetic field, of a turning frame, or of a rotor with a constant momentum l in the body,
        :math:`l \times \omega`. In three dimensions also the vector l. Of a product a tuple, of a
        power that of all factors. It may be given on Euclidean space, and on rotations of space in
        body axes.
    joints
        A sequence of `Joint`. Bodies are counted in the order of the factors: an ``SO3`` or
        ``UnitQuaternion`` and a ``Euclidean(3)`` that follow each other in one product are the
        attitude and the position of one; alone they turn about the origin, or are a point mass.
    constraints
        A function of a configuration that returns m numbers, shape ``(m,)``, which vanish for all
        times; it gets one point of ``frame``. Or this function and its derivatives along the
        fields, which return shape ``(m, frame.dim)``; by default they are differences.

    Raises
    ------
    TypeError
        If ``frame`` isn't a `Frame`, or a joint no `Joint`.
    ValueError
        If the free motion isn't known for the frame or for the inertia, or if this has another
        shape or isn't positive definite.

    Notes
    -----
    Splitting methods move points along the free motion and along forces in turn, and are
    symplectic. Their forces depend on time and configuration only. The free motion of a rigid
    body is computed by Jacobi's elliptic functions [1]_.

    With a gyroscopic force, splitting methods move points exactly on Euclidean space, and with a
    rotor if the moments of inertia are equal, or those about the other axes than that of the rotor.
    With others the motion between forces is composed of exact parts, of order six, and methods of
    order eight have order six.

    On a sphere the momentum is :math:`q \times p`, and the inertia is the mass. `join` removes
    its component along q, and forces along q have no effect.

    With joints or constraints, ``"RATTLE"`` and its compositions are the splitting methods, and
    other methods move along the forces of joints. Points are moved to where the joints are closed
    after each step, in the metric of the inertia, and momenta that would open them are removed.

    ``jac`` and ``df_dp`` must be None on a phase space; derivatives of forces are differences. With
    splitting methods, those of the free motion are exact to rounding, so that transition matrices
    are symplectic up to the errors of these differences, 1e-10.

    References
    ----------
    .. [1] E. Celledoni, F. Fassò, N. Säfström, A. Zanna, "The exact computation of the free rigid
       body motion and its use in splitting methods", SIAM J. Sci. Comput. 30 (2008), 2084-2112.

    Examples
    --------
    A heavy top: the unit vector :math:`k = q^T e_3` is vertical, the centre of mass is on the third
    axis of the body.

    >>> import numpy as np
    >>> import crouch_grossman as cg
    >>> frame = cg.frames.PhaseSpace(cg.frames.SO3(), inertia=[1.0, 1.6, 2.3])
    >>> def f(t, y):
    ...     q, momentum = frame.split(y)
    ...     return np.cross(q[2], [0.0, 0.0, -1.0])
    >>> y0 = frame.join(np.eye(3), [0.5, 0.1, 2.0])
    >>> frame.kinetic_energy(y0).round(6)
    np.float64(0.99769)
    """

    configuration: Frame
    inertia: Inertia
    gyroscopic: Any
    joints: tuple[Joint, ...]
    constraints: tuple[Callable[..., Any], Callable[..., Any] | None] | None
    _bodies: tuple[Body, ...] = field(init=False, compare=False)

    def __init__(
        self, frame: Frame, inertia: Any = None, *, gyroscopic: Any = None,
        joints: Iterable[Joint] = (), constraints: Any = None,
    ) -> None:  # fmt: skip
        check_frame(frame)
        numbers, bodies = read_inertia(frame, inertia, gyroscopic=gyroscopic)
        super().__init__(frame, Euclidean(frame.dim))
        vars(self).update(
            configuration=frame, inertia=None if inertia is None else numbers, _bodies=bodies,
            gyroscopic=hashable(gyroscopic), joints=read_joints(joints),
            constraints=read_constraints(constraints),
        )  # fmt: skip
        if self.jointed:
            linkage_of(self)

    def __repr__(self) -> str:
        inertia = "" if self.inertia is None else f", {self.inertia!r}"
        if self.gyroscopic is not None:
            inertia += f", gyroscopic={self.gyroscopic!r}"
        joints = f", joints={[*self.joints]!r}" if self.joints else ""
        constraints = "" if self.constraints is None else f", constraints={self.constraints!r}"
        return f"PhaseSpace({self.configuration!r}{inertia}{joints}{constraints})"

    @property
    def has_conditions(self) -> bool:
        """Whether points of the factors aren't points of the phase space."""
        return self.jointed or any(body.sphere for body in self._bodies)

    @property
    def jointed(self) -> bool:
        return bool(self.joints) or self.constraints is not None

    def join(self, *parts: ArrayLike) -> Array:
        """Return the flat point, shape ``(..., n)``, of a configuration and a momentum.

        The component along the point is removed from momenta on spheres. With joints the
        configuration is moved to where they are closed, and momenta that would open them are
        removed.

        Parameters
        ----------
        *parts
            The configuration, shape ``(..., *configuration.point_shape)``, and the momentum, shape
            ``(..., configuration.dim)``.

        Raises
        ------
        ValueError
            If the number of parts or the shape of one of them is wrong, if joints can't be closed
            near the configuration, or their constraints depend on each other there.
        """
        if len(parts) != 2:
            raise ValueError(f"parts must be a configuration and a momentum, got {len(parts)}")
        y = self._tangential_join(parts)
        return self._closed(y) if self.jointed else y

    def _tangential_join(self, parts: Sequence[ArrayLike]) -> Array:
        """Return points of configurations and momenta, whose joints may be open."""
        y = super().join(*parts)
        momentum = y[..., self._point_slices[1]]
        momentum[...] = self.tangential(y, momentum)
        return y

    def _closed(self, y: Array) -> Array:
        """Return finite points with closed joints; ValueError if there are none nearby."""
        closed = linkage_of(self).close(y)
        lost = np.isfinite(y).all(axis=-1) & ~np.isfinite(closed).all(axis=-1)
        if lost.any():
            self.check_rank(y[lost][0] if y.ndim > 1 else y, "the configuration")
            raise ValueError("the configuration must nearly close joints, got one far from that")
        return closed

    def check_rank(self, y: Array, name: str = "the point") -> None:
        """Raise ValueError if constraints depend on each other at a point."""
        if self.jointed:
            linkage_of(self).check_rank(y, name)

    def multipliers(self, y: ArrayLike, f: ArrayLike) -> tuple[Array, ...]:
        r"""Return the forces of joints, which keep their constraints.

        The equations of motion with them are :math:`\mu' = \dots + \tau + G^T \lambda` with the
        derivatives G of the constraints g along the fields. The constraints of a ball, and the
        first three of other joints with a common point, are the coordinates of the first body's
        point less those of the second one's, so that these :math:`\lambda` are the force on the
        first body in space axes. A slider has its forces along the first two axes of the first
        body, a distance has the force between the points, positive if it pushes. Other
        constraints are cosines between axes: third and first, third and second of a hinge, both
        third ones of a universal joint, and first and second, second and third, third and first
        of others. Their :math:`\lambda` are torques on the first body about the vector product of
        its axis and that of the second one.

        Parameters
        ----------
        y
            Points, shape ``(..., n)``.
        f
            The forces on the bodies there, as right-hand sides return them, shape
            ``(..., configuration.dim)``.

        Returns
        -------
        tuple of ndarray
            Multipliers of each joint, shape ``(..., number of its constraints)``, then of
            constraints of one's own if there are any. NaN where constraints depend on each other.

        Raises
        ------
        ValueError
            If the last axis of ``y`` or ``f`` has another length.
        """
        if not self.jointed:
            return ()
        point, force = self._points(y), real_array(f, "f")
        if force.shape[-1:] != (self.rhs_dim,):
            raise ValueError(f"f must have shape (..., {self.rhs_dim}), got {force.shape}")
        lead = np.broadcast_shapes(point.shape[:-1], force.shape[:-1])
        point = np.broadcast_to(point, (*lead, *self.point_shape))
        linkage = linkage_of(self)
        values = linkage.forces(point, self._completed(force, point))[1]
        return tuple(values[..., rows] for rows in linkage.slices)

    def tangential(self, y: Array, covector: Array) -> Array:
        """Return momenta or forces without the components along points of spheres."""
        result = covector
        for body in self._bodies:
            if body.sphere:
                result = result.copy() if result is covector else result
                q, p = y[..., body.points], covector[..., body.vectors]
                result[..., body.vectors] = p - (np.vecdot(q, p) / np.vecdot(q, q))[..., None] * q
        return result

    def random_point(self, rng: np.random.Generator, size: Size = ()) -> Array:
        if not self.jointed:
            return self._tangential_join(self.split(super().random_point(rng, size)))
        y = np.full((*check_random(rng, size), *self.point_shape), np.nan)
        for _ in range(_TRIES):
            lost = ~np.isfinite(y).all(axis=-1)
            points = [factor.random_point(rng, int(lost.sum())) for factor in self.factors]
            y[lost] = linkage_of(self).close(self._tangential_join(points))
            if np.isfinite(y).all():
                return y
        raise ValueError(f"joints must be closed near random points of {self.configuration!r}")

    def mean(self, points: ArrayLike, weights: ArrayLike | None = None) -> Points:
        return self.join(*self.split(super().mean(points, weights)))

    def velocity(self, y: ArrayLike) -> Array:
        r"""Return the velocities :math:`\omega = J^{-1} \mu`, shape ``(..., configuration.dim)``.

        Raises
        ------
        ValueError
            If the last axis of ``y`` hasn't the length of a point.
        """
        momentum, bodies = self._points(y)[..., self._point_slices[1]], self._bodies
        velocities = [rows_times(momentum[..., body.vectors], body.inverse) for body in bodies]
        return np.concatenate(velocities, axis=-1)

    def kinetic_energy(self, y: ArrayLike) -> Array:
        r"""Return :math:`\tfrac12 \langle\mu, \omega\rangle`, shape ``(...)``.

        Raises
        ------
        ValueError
            If the last axis of ``y`` hasn't the length of a point.
        """
        momentum = self._points(y)[..., self._point_slices[1]]
        return np.asarray(0.5 * np.vecdot(momentum, self.velocity(y)))

    def random_momentum(self, q: ArrayLike, temperature: float, rng: np.random.Generator) -> Array:
        r"""Return random momenta in thermal equilibrium, shape ``(..., configuration.dim)``.

        Their probability is proportional to :math:`e^{-K / T}` with the kinetic energy K.

        Parameters
        ----------
        q
            Configurations, shape ``(..., *configuration.point_shape)``.
        temperature
            The temperature T times Boltzmann's constant, an energy.
        rng
            The generator of random numbers.

        Raises
        ------
        ValueError
            If the temperature is negative or not finite, or joints can't be closed nearby.
        """
        temperature = check_real("temperature", temperature)
        check_generator("rng", rng)
        lead = np.shape(q)[: np.ndim(q) - len(self.configuration.point_shape)]
        xi = np.sqrt(temperature) * rng.standard_normal((*lead, self.configuration.dim))
        for body in self._bodies:
            root = body.root if body.root.shape[1] == 1 else body.root.T
            xi[..., body.vectors] = rows_times(xi[..., body.vectors], root)
        return self.join(q, xi)[..., self._point_slices[1]]

    @property
    def rhs_dim(self) -> int:
        """Number of forces, that of the configuration's fields."""
        return self.configuration.dim

    def complete_rhs(self, f: Array, y: Array) -> Array:
        whole = self._completed(f, y)
        return linkage_of(self).forces(y, whole)[0] if self.jointed else whole

    def _completed(self, f: Array, y: Array) -> Array:
        """Return velocities, and derivatives of momenta without the forces of joints."""
        velocity, momentum = self.velocity(y), y[..., self._point_slices[1]]
        slope = np.broadcast_to(self.tangential(y, f), momentum.shape).copy()
        for body in self._bodies:
            at = (..., body.vectors)
            if body.top is not None:
                slope[at] += np.cross(momentum[at], velocity[at])
            if body.gyroscopic is not None:
                slope[at] += velocity[at] @ body.gyroscopic.T
        return np.concatenate([velocity, slope], axis=-1)

    def membership_error(self, y: ArrayLike) -> Array:
        """Return the largest error of a factor, of a constraint or of its derivative by time."""
        return self._with_joints(y, super().membership_error(y))

    def relative_error(self, y: ArrayLike) -> Array:
        return self._with_joints(y, super().relative_error(y), relative=True)

    def state_error(self, y: ArrayLike) -> Array:
        """Return the relative error, or the part of momenta along points of spheres.

        This is left out where it may be an error of steps, whose forces are tangential at other
        points than their ends.
        """
        return np.asarray(
            np.maximum(self.relative_error(y), self._radial_momentum(self._points(y)))
        )

    def _radial_momentum(self, y: Array) -> Array:
        largest = np.zeros(y.shape[:-1])
        for body in self._bodies:
            if body.sphere:
                q, momentum = y[..., body.points], y[..., self._point_slices[1]][..., body.vectors]
                along = np.abs(np.vecdot(q, momentum)) / np.linalg.norm(q, axis=-1)
                is_large = along > _ALONG * np.linalg.norm(momentum, axis=-1)
                largest = np.maximum(largest, np.where(is_large, along, 0.0))
        return largest

    def _reason(self, point: Points) -> str:
        if self._radial_momentum(point):
            return "; join(q, momentum) removes the momentum along points of spheres"
        if not np.isfinite(self.state_error(point)):
            return "; constraints aren't finite there"
        return super()._reason(point)

    def _with_joints(self, y: ArrayLike, error: Array, relative: bool = False) -> Array:
        if not self.jointed:
            return error
        errors = np.abs(linkage_of(self).errors(self._points(y), relative)).max(axis=-1)
        return np.asarray(np.maximum(error, errors))

    def _project(self, y: Array) -> Array:
        projected = super()._project(y)
        return linkage_of(self).close(projected) if self.jointed else projected

    def compiled_bodies(self) -> tuple[NDArray[np.intc], Array]:
        """Return the columns and the constants of all bodies, as compiled code reads them."""
        return compiled_bodies(self._bodies)

    _blocks = Product._blocks  # compiled too, see `Frame.compiled_blocks`


@cached_by_value
def linkage_of(frame: PhaseSpace) -> Linkage:
    """Return the joints of a phase space in compiled code, which are kept."""
    return Linkage(frame)

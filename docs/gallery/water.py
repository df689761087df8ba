r"""Rigid water molecules in vacuum, with the potential of the model SPC [1]_.

A molecule has its centre of mass and its attitude, a unit quaternion. Charges are on the three
atoms, a Lennard-Jones potential acts between oxygens. Lengths are in ångström, masses in dalton,
energies in kJ/mol, so that the unit of time is 0.1 ps.

References
----------
.. [1] H. J. C. Berendsen et al., "Interaction models for water in relation to protein hydration",
   in *Intermolecular Forces*, Reidel, 1981, 331-342.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from cg.frames import Euclidean, PhaseSpace, Power, Product, UnitQuaternion

BOLTZMANN, COULOMB = 0.00831446, 1389.3546
SIGMA, EPSILON = 3.166, 0.650
CHARGES = np.array([-0.82, 0.41, 0.41])
MASSES = np.array([15.9994, 1.008, 1.008])
TURN = 0.4  # about a libration

_atoms = np.sqrt([[0.0, 0.0, 0.0], [2 / 3, 0.0, 1 / 3], [2 / 3, 0.0, 1 / 3]])
_atoms[2, 0] *= -1.0
SITES = _atoms - MASSES @ _atoms / MASSES.sum()
INERTIA = tuple(MASSES @ (np.sum(SITES**2, axis=1)[:, None] - SITES**2))


def phase_space(molecules: int) -> PhaseSpace:
    """Return the phase space of some molecules."""
    one = Product(Euclidean(3), UnitQuaternion())
    return PhaseSpace(Power(one, molecules), (float(MASSES.sum()), INERTIA))


frame = phase_space(2)
_points = [[0.0, 0.0, 0.0, 0.0, 0.28, 0.0, 0.96], [2.9, 0.1, 0.0, 0.6, 0.64, 0.0, 0.48]]
y0 = frame.join(_points, [1.0, 0.0, 2.0, 0.5, 1.0, 0.5, -1.0, 0.0, -2.0, 0.5, -0.5, 1.0])


def rotated(q: Any, vectors: Any, sign: float = 1.0) -> Any:
    """Return vectors of body axes in space, with ``sign=-1`` vice versa."""
    x, w = sign * q[..., 3:6], q[..., 6:]
    turn = 2.0 * np.cross(x, vectors)
    return vectors + w * turn + np.cross(x, turn)


def pairs(q: Any) -> tuple[Any, Any, Any]:
    """Return the energy, the forces on atoms in space, and the arms; q has shape ``(n, 7)``."""
    n, arm = len(q), rotated(q[:, None], SITES)
    atoms = (q[:, None, :3] + arm).reshape(-1, 3)
    square = sum((x[:, None] - x) ** 2 for x in atoms.T)
    for k in range(3):  # atoms of one molecule don't act on each other
        for m in range(3):
            square[k::3, m::3][np.diag_indices(n)] = np.inf
    charges = np.tile(CHARGES, n)
    electric = COULOMB * np.outer(charges, charges) / np.sqrt(square)
    near = (SIGMA**2 / square[::3, ::3]) ** 3
    energy = 0.5 * electric.sum() + 2.0 * EPSILON * (near**2 - near).sum()
    slope = electric
    slope[::3, ::3] += 24.0 * EPSILON * (2.0 * near**2 - near)
    slope /= square
    forces = slope.sum(axis=1)[:, None] * atoms - slope @ atoms
    return energy, forces.reshape(arm.shape), arm


def f(t: float, y: Any) -> Any:
    """Return forces in space and torques in body axes of any number of molecules."""
    q = y[: 7 * len(y) // 13].reshape(-1, 7)
    _, forces, arm = pairs(q)
    torque = rotated(q, np.cross(arm, forces).sum(axis=-2), -1.0)
    return np.concatenate([forces.sum(axis=-2), torque], axis=-1).ravel()


def invariants(y: Any) -> dict[str, Any]:
    """Return the energy, the momentum and the angular momentum."""
    frame = phase_space(y.shape[-1] // 13)
    q, momentum = frame.split(y)
    momentum = momentum.reshape(*q.shape[:-1], 6)
    energy = np.array([pairs(point)[0] for point in q.reshape(-1, *q.shape[-2:])])
    linear = momentum[..., :3]
    angular = np.cross(q[..., :3], linear) + rotated(q, momentum[..., 3:])
    return {
        "energy": frame.kinetic_energy(y) + energy.reshape(y.shape[:-1]),
        "momentum": linear.sum(axis=-2),
        "angular momentum": angular.sum(axis=-2),
    }

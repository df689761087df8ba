"""Mechanical systems with potentials that are linear in the entries of the configuration."""

from dataclasses import dataclass

import numpy as np

import cg
from cg.frames import PhaseSpace

INERTIA = [1.0, 1.6, 2.3]
MATRIX = [[1.3, 0.1, 0.2], [0.1, 1.6, -0.3], [0.2, -0.3, 2.1]]
SPLITTINGS = [name for name, method in cg.methods.items() if isinstance(method, cg.Splitting)]


@dataclass
class System:
    """A potential Re <weights, q> on a phase space, and an initial point."""

    frame: PhaseSpace
    weights: np.ndarray
    y0: np.ndarray

    def f(self, t, y):
        configuration = self.frame.configuration
        shape = configuration.point_shape
        q = self.frame.split(y)[0].reshape(*y.shape[:-1], 1, *shape)
        fields = configuration.field(np.eye(configuration.dim), q)
        axes = tuple(range(-len(shape), 0))
        return -(self.weights.conj() * fields).real.sum(axis=axes)

    def energy(self, y):
        q, _ = self.frame.split(y)
        axes = tuple(range(-len(self.frame.configuration.point_shape), 0))
        return self.frame.kinetic_energy(y) + (self.weights.conj() * q).real.sum(axis=axes)

    def run(self, method, span=(0.0, 1.0), y0=None, **options):
        start = self.y0 if y0 is None else y0
        return cg.solve_ivp(self.f, span, start, frame=self.frame, method=method, **options)

    def reference(self, span=(0.0, 1.0), **options):
        return self.run("DOP853", span, rtol=1e-13, atol=1e-13, **options)


def system(configuration, inertia=None, seed=5):
    """Return a system with random weights and a random point."""
    rng = np.random.default_rng(seed)
    frame = PhaseSpace(configuration, inertia)
    shape = configuration.point_shape
    weights = rng.standard_normal(shape).astype(configuration.dtype)
    if configuration.dtype.kind == "c":
        weights += 1j * rng.standard_normal(shape)
    q = configuration.random_point(rng)
    return System(frame, weights, frame.join(q, rng.standard_normal(configuration.dim)))

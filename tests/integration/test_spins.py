"""Spins without damping: sequences of midpoint steps in the ambient space are symplectic."""

import numpy as np
import pytest
from quotients import derivative

import cg
from cg.frames import Euclidean, Power, Sphere

MIDPOINTS = ["ImplicitMidpoint", "DICG4", "DICG4c", "DICG6"]


class Spins:
    """Spins or vortices s_i' = s_i × ∂H/∂s_i / strength_i, with a random H of degree four."""

    def __init__(self, seed, n=3):
        rng = np.random.default_rng(seed)
        couplings = rng.standard_normal((3 * n, 3 * n))
        self.couplings = (couplings + couplings.T) / np.linalg.norm(couplings, 2) / 2
        self.fields, self.quartic = rng.standard_normal((2, 3 * n))
        self.strengths = rng.uniform(0.5, 2.0, (n, 1)) * rng.choice([-1.0, 1.0], (n, 1))
        self.y0 = self.unit(rng.standard_normal((n, 3)))
        self.frame, self.sphere = Euclidean(3 * n), Power(Sphere(2), n)

    @staticmethod
    def unit(s):
        return s / np.linalg.norm(s, axis=-1, keepdims=True)

    def turning(self, t, s):
        """Return the rotation vectors, on spheres."""
        y = s.ravel()
        gradient = self.couplings @ y + self.fields + self.quartic * y**3 / 3
        return (-gradient.reshape(s.shape) / self.strengths).ravel()

    def f(self, t, y):
        """Return derivatives in the ambient space."""
        s = self.unit(np.reshape(y, (-1, 3)))
        return np.cross(self.turning(t, s).reshape(s.shape), s).ravel()

    def end(self, method, h, s=None, time=None, *, sphere=False):
        s, f = self.y0 if s is None else s, self.turning if sphere else self.f
        frame = self.sphere if sphere else self.frame
        run = cg.integrate(
            f, (0, time or h), s.reshape(frame.point_shape), frame=frame, method=method, h=h
        )
        return run.y[-1].reshape(s.shape)

    def area_defect(self, method, h, **options):
        """Return by how much a step changes areas Σ strength s·(u × v), by differences."""
        moves = np.eye(self.sphere.dim)

        def areas(s, vectors):
            return np.einsum("ni,uvni->uv", self.strengths * s, np.cross(vectors[:, None], vectors))

        before = np.cross(moves.reshape(-1, *self.y0.shape), self.y0)
        end = lambda v: self.end(method, h, self.sphere.flow(v, self.y0), **options)
        after = np.array([derivative(lambda s, v=v: end(s * v), bound=1e-8) for v in moves])
        change = areas(self.end(method, h, **options), after) - areas(self.y0, before)
        return np.abs(change).max()


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("method", MIDPOINTS)
def test_steps_keep_areas_and_lengths(method, seed):
    spins = Spins(seed)
    assert spins.area_defect(method, 0.3) < 1e-7
    ends = spins.end(method, 0.1, time=20.0)
    assert np.abs(np.linalg.norm(ends, axis=-1) - 1).max() < 1e-13


@pytest.mark.parametrize("seed", range(3))
def test_other_steps_do_not_keep_areas(seed):
    spins = Spins(seed)
    assert spins.area_defect("ImplicitMidpoint", 0.3, sphere=True) > 1e-4
    assert spins.area_defect("DICG4b", 0.6) > 1e-6
    assert spins.area_defect("CF4", 0.6, sphere=True) > 1e-5


@pytest.mark.parametrize("seed", range(3))
def test_suzukis_steps_have_smaller_errors_at_equal_work(seed):
    spins = Spins(seed)
    exact = spins.end("DICG6", 0.02, time=2.0)
    errors = [
        np.abs(spins.end(method, h, time=2.0) - exact).max()
        for method, h in (("DICG4", 3 / 60), ("DICG4c", 5 / 60))
    ]
    assert errors[0] > 2 * errors[1] > 1e-9

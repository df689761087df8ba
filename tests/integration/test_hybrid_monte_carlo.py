"""Hybrid Monte Carlo of SU(3) on a lattice: reversible, areas kept, errors of the known order."""

import numpy as np
import pytest
from gallery import load

import cg
from cg.frames import PhaseSpace

BETA = 5.0


class Chain:
    """The mechanical system of Wilson's action, and points in equilibrium."""

    def __init__(self):
        self.lattice = load("gradient_flow").GradientFlow((2, 3), roughness=0.4, seed=3)
        self.frame = PhaseSpace(self.lattice.frame)
        self.rng = np.random.default_rng(8)
        self.links = self.lattice.y0
        for _ in range(20):
            self.links = self.frame.split(self.end(self.start(), "BlanesMoan4", 0.25))[0]

    def f(self, t, y):
        return BETA / 6 * self.lattice.f(t, self.frame.split(y)[0])

    def energy(self, y):
        return self.frame.kinetic_energy(y) + 2 * BETA * self.lattice.action(self.frame.split(y)[0])

    def start(self):
        momenta = self.rng.standard_normal(self.frame.configuration.dim)
        return self.frame.join(self.links, momenta)

    def end(self, y, method, h):
        return cg.integrate(self.f, (0, 1), y, frame=self.frame, method=method, h=h).y[-1]


@pytest.fixture(scope="module")
def chain():
    return Chain()


def test_the_mean_weight_in_equilibrium_is_one(chain):
    links = chain.links
    changes = []
    for _ in range(200):
        y = chain.start()
        end = chain.end(y, "Leapfrog", 0.25)
        changes.append(chain.energy(end) - chain.energy(y))
        if chain.rng.random() < np.exp(-changes[-1]):
            chain.links = chain.frame.split(end)[0]
    chain.links = links
    weights = np.exp(-np.array(changes))
    assert weights.std() > 0.05
    assert abs(weights.mean() - 1) < 4 * weights.std() / np.sqrt(len(weights))

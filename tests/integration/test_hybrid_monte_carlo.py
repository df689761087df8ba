"""Hybrid Monte Carlo of SU(3) on a lattice: reversible, areas kept, errors of the known order."""

import numpy as np
import pytest
from gallery import load

import cg
from cg.frames import PhaseSpace
from tests.helpers.mechanics import SPLITTINGS

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


@pytest.mark.parametrize("method", SPLITTINGS)
def test_changes_of_the_energy_have_the_order_and_can_be_undone(chain, method):
    order = cg.methods[method].order
    coarse = {2: 10, 4: 5, 6: 4, 8: 3}[order]
    starts = [chain.start() for _ in range(3)]
    sizes = [
        np.sqrt(np.mean([(chain.energy(chain.end(y, method, 1 / n)) - chain.energy(y)) ** 2
                         for y in starts]))
        for n in (coarse, 2 * coarse)
    ]  # fmt: skip
    assert sizes[1] > 1e-12
    assert np.log2(sizes[0] / sizes[1]) > order - 0.3
    links, momenta = chain.frame.split(chain.end(starts[0], method, 1 / coarse))
    back = chain.end(chain.frame.join(links, -momenta), method, 1 / coarse)
    links, momenta = chain.frame.split(back)
    assert np.abs(chain.frame.join(links, -momenta) - starts[0]).max() < 1e-12


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

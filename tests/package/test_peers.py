"""Trees, classical conditions and steps equal those of kauri and Lielab."""

from collections import defaultdict
from fractions import Fraction

import numpy as np
import pytest
from kinds import FROZEN

import cg
from cg.construction.methods.flat import flat_residuals
from cg.construction.methods.low_storage import two_registers
from cg.construction.trees.ordered import forest
from cg.construction.trees.rooted import rooted_trees_through
from cg.problems import HeavyTop

NODES = 8


@pytest.fixture(scope="module")
def kauri():
    return pytest.importorskip("kauri")


@pytest.fixture(scope="module")
def coefficients():
    return pytest.importorskip("lielab.integrate").CrouchGrossmanCoefficients


def nested(tree):
    return [nested(child) for child in tree.children]


class TestTrees:
    @pytest.mark.parametrize("nodes", range(1, NODES + 1))
    def test_planar_trees_equal_kauri(self, kauri, nodes):
        trees = forest(nodes)
        ours = [kauri.PlanarTree(nested(trees.tree(t))) for t in trees.with_nodes(nodes)]
        theirs = list(kauri.planar_trees_of_order(nodes))
        assert len(ours) == len(theirs)
        assert set(ours) == set(theirs)

    @pytest.mark.parametrize("nodes", range(1, NODES + 1))
    def test_densities_sum_to_tree_factorials(self, kauri, nodes):
        # over all orders of children, 1 / γ adds up to |t| / (t! σ(t)) of the tree without order
        trees = forest(nodes)
        sums = defaultdict(Fraction)
        for t in trees.with_nodes(nodes):
            planar = kauri.PlanarTree(nested(trees.tree(t)))
            sums[planar.to_nonplanar_tree()] += Fraction(1, trees.density[t - 1])
        theirs = list(kauri.trees_of_order(nodes))
        assert len(sums) == len(theirs)
        for tree in theirs:
            assert sums[tree] == Fraction(nodes, tree.factorial() * tree.sigma())


class TestOrders:
    @pytest.mark.parametrize("stages", range(1, 7))
    def test_classical_residuals_equal_kauri(self, kauri, stages):
        entries = np.random.default_rng(stages).integers(-9, 10, (stages + 1, stages))
        *a, b = [[Fraction(int(x), 7) for x in row] for row in entries]
        weights = kauri.RK(a, b).elementary_weights_map()
        trees = [kauri.Tree(list(map(list, tree))) for tree in rooted_trees_through(6)]
        theirs = [weights(tree) - 1 / tree.factorial() for tree in trees]
        np.testing.assert_allclose([*map(float, flat_residuals(a, b, 6))], theirs, rtol=1e-11)

    def test_orders_of_the_catalogue_equal_kauri(self, kauri):
        methods = [m for m in FROZEN.values() if m.explicit and m.order < 7 and not m.approximate]
        orders = [kauri.RK(m.a.tolist(), m.b.tolist()).order() for m in methods]
        assert orders == [m.order for m in methods]

    def test_planar_orders_of_kauri_are_others(self, kauri):
        # they compare with factorials of trees: docs/implementations.md
        cf = pytest.importorskip("kauri.cf")
        single = cf.CFMethod(
            [[0] * 4, [0.5, 0, 0, 0], [0, 0.5, 0, 0], [0, 0, 1, 0]], [[1 / 6, 1 / 3, 1 / 3, 1 / 6]]
        )
        points = [(-1, {0: "1/2"}), (-1, {1: "1/2"}), (-1, {2: 1})]
        points.append((-1, {0: "1/6", 1: "1/3", 2: "1/3", 3: "1/6"}))
        assert (single.planar_order(), cg.CommutatorFree(points, [-1, 0, 1, 2]).order) == (4, 2)
        for name in ("CF3b", "CF4b", "CF5r"):
            a, b = ([*map(float, values)] for values in two_registers(cg.methods[name]))
            assert cf.ReusedStageCFMethod(a[1:], b).planar_order() == 2


class TestLielab:
    """Lielab multiplies points from the left, the package from the right."""

    @pytest.mark.parametrize("name", ["CG4a", "CG5a"])
    @pytest.mark.parametrize("h", [0.1, 0.01])
    def test_steps_equal_lielab(self, coefficients, name, h):
        from lielab_top import LielabTop

        top = HeavyTop()
        lielab = LielabTop(top)
        lielab.options.crouch_grossman_coefficients = getattr(coefficients, name)
        theirs = lielab.integrate(h, 10)

        # with the transpose of the attitude, flows on the left are flows on the right
        def f(t, y):
            rotation, momentum = y[:9].reshape(3, 3).T, y[9:]
            velocity = momentum / top.inertia
            turned = np.cross(momentum, velocity) + top.mgl * np.cross(rotation[2], [0, 0, 1])
            return np.concatenate([-rotation @ velocity, turned])

        start = np.concatenate([top.y0[:9].reshape(3, 3).T.ravel(), top.y0[9:]])
        ours = cg.integrate(f, (0, 10 * h), start, frame=top.frame, method=name, h=h).y.copy()
        ours[:, :9] = ours[:, :9].reshape(-1, 3, 3).swapaxes(1, 2).reshape(-1, 9)
        # The top magnifies rounding some 16 times while it runs ten of the long steps.
        np.testing.assert_allclose(ours, theirs, rtol=0, atol=1e-14)
        assert np.abs(ours[-1] - ours[0]).max() > 0.1 * h
        other = cg.integrate(f, (0, 10 * h), start, frame=top.frame, method="CG4", h=h).y
        assert np.abs(other[1:, 9:] - theirs[1:, 9:]).max() > 1e-13

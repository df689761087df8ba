"""Trees, classical conditions and steps equal those of kauri and Lielab."""

from collections import defaultdict
from fractions import Fraction

import numpy as np
import pytest
from kinds import FROZEN
from scipy.spatial.transform import Rotation

import cg
from cg.construction.methods.classical_conditions import flat_residuals
from cg.construction.methods.low_storage import two_registers
from cg.construction.trees import forest, rooted_trees_through
from cg.frames import SE3, UnitQuaternion
from cg.problems import HeavyTop

pytestmark = pytest.mark.no_core

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


def points_of_lielab(top, coefficients, h, steps):
    """Return points of a heavy top, whose velocity in Lielab is in space axes."""
    from lielab import domain, integrate

    options = integrate.IVPOptions()
    options.method = integrate.IVPMethod.CrouchGrossman
    options.crouch_grossman_coefficients = coefficients
    options.variable_time_step = False
    options.dt, options.dt_min = h, 1e-9
    momentum = domain.RN(3)
    momentum.unserialize(top.y0[9:])
    start = domain.CompositeManifold([domain.SO(top.y0[:9].reshape(3, 3)), momentum])
    rotation_rate, momentum_rate = domain.so(3), domain.rn(3)

    def f(t, y):
        rotation, m = y.point[0].get_matrix(), y.point[1].serialize()
        velocity = m / np.array(top.inertia, float)
        rotation_rate.set_vector(rotation @ velocity)
        turn = np.cross(m, velocity) + float(top.mgl) * np.cross(rotation[2], [0, 0, 1])
        momentum_rate.set_vector(turn)
        return domain.CompositeAlgebra([rotation_rate, momentum_rate])

    system = integrate.HomogeneousIVPSystem(f)
    points = integrate.solve_ivp(system, np.array([0.0, h * steps]), start, options).ybar
    assert len(points) == steps + 1
    return np.asarray(points)


class TestLielab:
    """Lielab multiplies points from the left, the package from the right."""

    @pytest.mark.parametrize("name", ["CG4a", "CG5a"])
    @pytest.mark.parametrize("h", [0.1, 0.01])
    def test_steps_equal_lielab(self, coefficients, name, h):
        top = HeavyTop()
        theirs = points_of_lielab(top, getattr(coefficients, name), h, 10)

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


RANDOM = np.random.default_rng(53)
TURN = Rotation.random(rng=RANDOM)
Q, OMEGA, SPEED = TURN.as_quat(canonical=True), RANDOM.normal(size=3), RANDOM.normal(size=3)
MOVED = UnitQuaternion().flow(OMEGA, Q)  # by an angular velocity in body axes
close = np.testing.assert_allclose


def wxyz(q):
    return np.roll(q, 1)


def test_mujoco():
    mujoco = pytest.importorskip("mujoco")
    body = '<body><freejoint/><geom size="1"/></body>'
    model = mujoco.MjModel.from_xml_string(f"<mujoco><worldbody>{body}</worldbody></mujoco>")
    data = mujoco.MjData(model)
    data.qpos[:] = qpos = np.array([1.0, 2.0, 3.0, *wxyz(Q)])
    mujoco.mj_kinematics(model, data)
    close(data.xmat[1].reshape(3, 3), TURN.as_matrix(), atol=1e-15)
    mujoco.mj_integratePos(model, qpos, np.append(SPEED, OMEGA), 1.0)
    close(qpos, [*(np.array([1.0, 2.0, 3.0]) + SPEED), *wxyz(MOVED)], atol=1e-15)


def test_pinocchio():
    pin = pytest.importorskip("pinocchio")
    model = pin.Model()
    model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "body")
    moved = pin.integrate(model, np.append(np.zeros(3), Q), np.append(SPEED, OMEGA))
    pose = SE3().flow(
        np.append(OMEGA, SPEED), np.block([[TURN.as_matrix(), np.zeros((3, 1))], [np.eye(4)[3]]])
    )
    close(moved[:3], pose[:3, 3], atol=1e-15)
    close(Rotation.from_quat(moved[3:]).as_matrix(), pose[:3, :3], atol=1e-15)


def test_spatialmath():
    spatialmath = pytest.importorskip("spatialmath")
    q = spatialmath.UnitQuaternion(wxyz(Q))
    close(q.R, TURN.as_matrix(), atol=1e-15)
    close(q.dotb(OMEGA), wxyz(UnitQuaternion().field(OMEGA, Q)), atol=1e-15)
    close(q.dot(OMEGA), wxyz(UnitQuaternion("space").field(OMEGA, Q)), atol=1e-15)
    pose = spatialmath.Twist3(np.append(SPEED, OMEGA)).SE3().A
    close(pose, SE3().flow(np.append(OMEGA, SPEED), np.eye(4)), atol=1e-14)


def test_basilisk():
    kinematics = pytest.importorskip("Basilisk.utilities.RigidBodyKinematics")
    sigma = TURN.as_mrp()
    close(kinematics.MRP2C(sigma), TURN.as_matrix().T, atol=1e-15)
    close(kinematics.MRP2EP(sigma), wxyz(Q), atol=1e-15)
    close(kinematics.dEP(wxyz(Q), OMEGA), wxyz(UnitQuaternion().field(OMEGA, Q)), atol=1e-15)

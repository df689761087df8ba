"""The continuous solution: order, end points, membership in the manifold."""

import numpy as np
import pytest
from frame_examples import generic
from interpolants import extra_evaluations
from kinds import FROZEN
from numpy.polynomial import Polynomial
from refusals import refuses
from scipy.interpolate import CubicHermiteSpline

import cg
from cg import frames as fr
from cg.construction.methods.interpolant import nodes_of
from cg.integration.plan.callbacks import HANDLERS
from cg.problems.convergence import observed_order
from cg.support.shared_numbers import Operation

pytestmark = pytest.mark.sanitize

FRAMES = [
    fr.Euclidean(3), fr.SO3(), fr.SO3("space"), fr.UnitQuaternion(), fr.SE3(), fr.SO(4), fr.SU(2),
    fr.SL(2), fr.GL(2), fr.Sphere(2), fr.Sphere(3), fr.Stiefel(3, 1),
    fr.IsospectralOrbit((1.0, 2.0, 4.0)), fr.CoadjointOrbit(fr.SO3(), (0.6, 0.0, 0.8)),
    fr.Product(fr.SO3(), fr.Euclidean(2)), fr.Product(fr.UnitQuaternion(), fr.Sphere(2)),
]  # fmt: skip
T0 = 0.3


def one_step(frame, h, method):
    """Return the solution of one step, and an accurate solution within it."""
    f, y0 = generic(frame)
    step = cg.solve_ivp(
        f, (T0, T0 + h), y0, frame=frame, method=method, h=abs(h), dense_output=True
    )
    assert step.steps == 1
    fine = cg.integrate(f, (T0, T0 + h), y0, frame=frame, method="CG6g", h=abs(h) / 6)
    return step, fine


IMPLICIT = [name for name, m in FROZEN.items() if not m.explicit and m.order < 6]


@pytest.mark.parametrize(("frame", "method", "sign"), [
    *((frame, *way) for frame in FRAMES for way in (("CG3", 1), ("CG4a", -1), ("CG5a", 1))),
    *((fr.SO3(), name, 1) for name in IMPLICIT),
], ids=str)  # fmt: skip
def test_local_order_is_that_of_the_steps(frame, method, sign):
    sizes = np.array([0.1, 0.05, 0.025])
    errors = []
    for h in sizes:
        step, fine = one_step(frame, sign * h, method)
        errors.append(frame.distance(step.sol(fine.t), fine.y).max())
    order = observed_order(sizes, errors, floor=2e-15)
    assert order > cg.methods[method].order + 0.6


@pytest.mark.parametrize("frame", FRAMES, ids=repr)
def test_the_ends_are_exact_and_all_is_on_the_manifold(frame):
    f, y0 = generic(frame)
    solution = cg.solve_ivp(f, (0, 2), y0, frame=frame, method="CG4a", h=0.3, dense_output=True)
    np.testing.assert_array_equal(solution.sol(solution.t), solution.y)
    points = solution.sol(np.linspace(0, 2, 41))
    assert points.shape == (41, *frame.point_shape)
    assert frame.membership_error(points).max() < 1e-13


@pytest.mark.filterwarnings("ignore:invalid value")
@pytest.mark.parametrize("method", ["CF5(4)", "RKMK5(4)"])
def test_a_flow_that_overflows_once_costs_one_step(method, monkeypatch):
    """Also where it is one to a node of the interpolant of an accurate step."""
    calls, fails, flow = [], [0], HANDLERS[Operation.FLOW]

    def counted(self, v, y):
        calls.append(self)
        return flow(self, v, y) * (np.nan if len(calls) == fails[0] else 1.0)

    def solve(call):
        calls.clear()
        fails[0] = call
        return cg.solve_ivp(
            lambda t, y: [0.1 * y[0, 0], 0.2, np.cos(t), 0.0], (0, 1), np.eye(2), frame=fr.GL(2),
            method=method, first_step=0.3, dense_output=True,
        )  # fmt: skip

    monkeypatch.setitem(HANDLERS, Operation.FLOW, counted)
    without = solve(0)
    for call in range(1, len(calls) + 1):
        solution = solve(call)
        assert solution.success
        assert solution.steps == len(solution.t) - 1 == len(solution.sol.ts) - 1
        # without a rejection, where the overflow only chose another form of the interpolant
        same = np.array_equal(solution.t, without.t)
        assert solution.nrejected == without.nrejected + (not same)


def test_on_flat_space_it_is_the_cubic_of_hermite_for_order_three():
    f, _ = generic(fr.Euclidean(3))
    step, _ = one_step(fr.Euclidean(3), 0.5, "CG3")
    ends = [(T0, step.y[0]), (T0 + 0.5, step.y[-1])]
    cubic = CubicHermiteSpline(*zip(*ends, strict=True), [f(t, y) for t, y in ends])
    t = np.linspace(T0, T0 + 0.5, 20)
    np.testing.assert_allclose(step.sol(t), cubic(t), rtol=0, atol=1e-14)


@pytest.mark.parametrize("count", range(2, 9))
def test_the_last_flow_removes_the_leading_error(count):
    """This holds for coefficients that are a polynomial of one degree more than interpolated."""
    rng = np.random.default_rng(count)
    nodes, blend = nodes_of(count)
    assert len(nodes) == count
    assert (np.diff(nodes) > 0).all()
    field = Polynomial(rng.standard_normal(count + 1))
    solution = field.integ()
    values = field(nodes)
    s = np.linspace(0, 1, 11)
    interpolated = Polynomial.fit(nodes, values, count - 1, domain=[0, 1], window=[0, 1])
    integral = interpolated.integ()
    rest = solution(1.0) - (integral(1.0) - integral(0.0))
    value = integral(s) - integral(0.0) + rest * blend(s)
    np.testing.assert_allclose(value, solution(s), rtol=0, atol=5e-14)


@pytest.mark.parametrize("method", ["CG2(3)", "CG4a", "CG5a", "CG6g"])
def test_evaluations_of_dense_output(method):
    f, y0 = generic(fr.SO3())
    extra = extra_evaluations(cg.methods[method])
    assert extra <= cg.methods[method].stages
    options = {"frame": fr.SO3(), "method": method, "h": 0.25}
    without = cg.solve_ivp(f, (0, 1), y0, **options)
    dense = cg.solve_ivp(f, (0, 1), y0, dense_output=True, **options)
    np.testing.assert_array_equal(without.y, dense.y)
    assert dense.nfev == without.nfev + 1 + 4 * extra
    some = cg.solve_ivp(f, (0, 1), y0, t_eval=[0.25, 0.3, 0.4, 0.5], **options)
    assert some.nfev == without.nfev + extra  # only one step has output inside of it


def test_times_may_have_any_shape_and_order():
    f, y0 = generic(fr.SO3())
    sol = cg.solve_ivp(f, (0, 1), y0, frame=fr.SO3(), dense_output=True).sol
    t = np.random.default_rng(0).random((4, 5))
    points = sol(t)
    assert points.shape == (4, 5, 3, 3)
    assert sol(0.5).shape == (3, 3)
    assert sol([]).shape == (0, 3, 3)
    for index in np.ndindex(4, 5):
        np.testing.assert_allclose(points[index], sol(t[index]), rtol=0, atol=1e-15)
    assert "DenseOutput" in repr(sol)


@pytest.mark.parametrize("t", [-0.1, 1.1, [0.5, np.nan]])
def test_times_beyond_the_ends_are_refused(t):
    f, y0 = generic(fr.SO3())
    sol = cg.solve_ivp(f, (0, 1), y0, frame=fr.SO3(), dense_output=True).sol
    refuses(ValueError, "t must", sol, t)


@pytest.mark.parametrize("frame", [fr.SPD(3), fr.Product(fr.Power(fr.SPD(3), 1))])
def test_output_near_singular_matrices(frame):
    rng, times = np.random.default_rng(0), np.linspace(-1.3, -1.4, 21)
    y0 = frame.random_point(rng)
    w, phase, speed = 0.5 * rng.normal(size=(9, 9)), rng.uniform(-3, 3, 9), rng.normal(size=9)

    def output(method, tolerance):  # an eigenvalue comes down to 7e-4
        return cg.solve_ivp(
            lambda t, y: 0.88 * np.sin(w @ y.ravel() + speed * t + phase) + 0.7 * np.cos(speed * t),
            (0, -1.5), y0, frame=frame, method=method, dense_output=True, rtol=tolerance,
            atol=tolerance,
        ).sol(times)  # fmt: skip

    expected = output("auto", 1e-11)
    for method in "DOP853", "CG5(4)":
        assert abs(output(method, 1e-8) - expected).max() < 1e-8

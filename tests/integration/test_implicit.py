"""Implicit methods: their stage equations, orders, invariants and failures."""

import numpy as np
import pytest
from kinds import FROZEN

import cg
from cg.construction.methods.tableau import Tableau
from cg.frames import SO3, Euclidean, Product
from cg.integration.arguments import STAGE_SOLVERS
from cg.problems import StateDependentRotation
from cg.support.memory import total_memory

MIDPOINT = Tableau([["1/2"]], ["1"], name="implicit midpoint")
TRAPEZOIDAL = Tableau([["0", "0"], ["1/2", "1/2"]], ["1/2", "1/2"], name="trapezoidal")
BACKWARD_EULER = Tableau([["1"]], ["1"], name="backward Euler")
# On flat manifolds of order 4; the flows don't commute, so its order is lower elsewhere.
GAUSS = Tableau(
    [["1/4", "-0.038675134594812882254574390251"], ["0.538675134594812882254574390251", "1/4"]],
    ["1/2", "1/2"],
    name="Gauss",
)
KINDS = list(STAGE_SOLVERS)
IMPLICIT = {name: m for name, m in FROZEN.items() if not m.explicit}
METHODS = [MIDPOINT, TRAPEZOIDAL, BACKWARD_EULER, GAUSS, *IMPLICIT.values()]
INERTIA = np.array([1.0, 2.0, 3.0])
MOMENTUM = np.array([0.8, 1.1, -0.6])
BODY = Product(SO3(), Euclidean(3))


def euler(t, y):
    """The free rigid body: attitude, and angular momentum in body axes."""
    m = y[9:]
    w = m / INERTIA
    return np.concatenate([w, np.cross(m, w)])


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("method", METHODS, ids=lambda m: m.name)
def test_stages_solve_their_equations(method, kind):
    """The step is redone from the coefficients that f returned last for each stage."""
    problem = StateDependentRotation()
    frame, h, t0 = problem.frame, 0.2, 0.3
    y0 = frame.random_point(np.random.default_rng(0))
    calls = []

    def f(t, y):
        calls.append((t, y.copy()))
        return problem.f(t, y)

    solution = cg.integrate(f, (t0, t0 + h), y0, frame=frame, method=method, h=h, stage_solver=kind)
    fields = []
    for c in method.c:
        at_stage = [y for t, y in calls if t == t0 + c * h]
        fields.append(problem.f(t0 + c * h, at_stage[-1]))
    for row, c in zip(method.a, method.c, strict=True):
        point = y0
        for a, v in zip(row, fields, strict=True):
            point = frame.flow(h * a * v, point)
        at_stage = [y for t, y in calls if t == t0 + c * h]
        np.testing.assert_allclose(at_stage[-1], point, rtol=0, atol=1e-14)
    point = y0
    for b, v in zip(method.b, fields, strict=True):
        point = frame.flow(h * b * v, point)
    np.testing.assert_allclose(solution.y[-1], point, rtol=0, atol=1e-14)
    assert solution.nfev == len(calls)


def test_newton_needs_fewer_evaluations_where_steps_are_large():
    y0 = BODY.join(np.eye(3), MOMENTUM)
    nfev = [
        cg.solve_ivp(euler, (0, 20), y0, frame=BODY, method=MIDPOINT, h=0.5, stage_solver=kind).nfev
        for kind in KINDS
    ]
    assert KINDS[0] == "newton"
    assert nfev[0] < 0.8 * nfev[1]


def test_newton_takes_steps_that_are_too_large_for_fixed_points():
    """A stiff spring in the momentum: |h df/dy| is 50."""

    f = lambda t, y: np.concatenate([[0.3, 0.1, y[9]], -1000.0 * (y[9:] - np.cos(t))])
    y0 = BODY.join(np.eye(3), [1.0, 1.0, 1.0])
    options = {"frame": BODY, "method": BACKWARD_EULER, "h": 0.1}
    solution = cg.integrate(f, (0, 2), y0, **options)
    np.testing.assert_allclose(solution.y[-1, 9:], np.cos(2.0), atol=2e-3)
    with pytest.raises(cg.ConvergenceError, match="diverges"):
        cg.integrate(f, (0, 2), y0, stage_solver="fixed-point", **options)


def test_message_of_failure():
    with pytest.raises(cg.ConvergenceError) as caught:
        cg.integrate(
            lambda t, y: -10.0 * y + t, (0.5, 2.0), [1.0], frame=Euclidean(1),
            method=BACKWARD_EULER, h=0.25, stage_solver="fixed-point",
        )  # fmt: skip
    error = caught.value
    assert error.t == 0.5
    assert error.h == 0.25
    assert 1 < error.iterations < STAGE_SOLVERS["fixed-point"]
    assert error.residual > 1.0
    for part in (f"after {error.iterations} iterations", "h = 0.25", "t = 0.5", "residual is"):
        assert part in str(error)


def test_implicit_pairs_choose_their_steps():
    """Stages that can't be found make a smaller step, not an error."""
    pair = Tableau(TRAPEZOIDAL.entries, ["1/2", "1/2"], b_embedded=["1", "0"])

    f = lambda t, y: np.array([y[2, 0], np.cos(t), -3.0 * y[0, 1]]) * (1.0 if t < 1.0 else 30.0)
    truth = cg.solve_ivp(f, (0, 2), np.eye(3), frame=SO3(), rtol=1e-7, atol=1e-7)
    for kind in KINDS:
        solution = cg.solve_ivp(
            f, (0, 2), np.eye(3), frame=SO3(), method=pair, stage_solver=kind, max_step=0.5,
            rtol=1e-4, atol=1e-4,
        )  # fmt: skip
        assert solution.success
        assert SO3().distance(solution.y[-1], truth.y[-1]) < 4e-4


@pytest.mark.parametrize("span", [(0.0, 2.0), (2.0, 0.0)], ids=["forward", "backward"])
@pytest.mark.parametrize("method", METHODS, ids=lambda m: m.name)
def test_functions_of_time_give_what_functions_of_points_give(method, span):
    """Stages of functions of time need no points, but the paths to the result do."""

    def spin(t):
        return [np.sin(t), 0.3, np.cos(2.0 * t), 1.0]

    frame, y0 = Product(SO3(), Euclidean(1)), [*np.eye(3).ravel(), 0.0]
    options = {"frame": frame, "method": method, "h": 0.1, "dense_output": True}
    linear = cg.solve_ivp(spin, span, y0, linear=True, **options)
    other = cg.solve_ivp(lambda t, y: spin(t), span, y0, **options)
    np.testing.assert_allclose(linear.y, other.y, rtol=0.0, atol=2e-14)
    np.testing.assert_allclose(linear.sol(0.77), other.sol(0.77), rtol=0.0, atol=2e-14)


@pytest.mark.parametrize("rate", [1e3, 1e6])
def test_fixed_steps_end_newton_where_rounding_of_f_keeps_corrections_from_decreasing(rate):
    run = cg.integrate(
        lambda t, y: -rate * ((y + 1e5) - 1e5 - np.cos(t)), (0, 3), [1.0],
        frame=cg.frames.Euclidean(1), method="RadauIIA5", h=0.1,
    )  # fmt: skip
    assert abs(run.y[-1, 0] - np.cos(3) - np.sin(3) / rate) < 2 / rate**2 + 1e-10


@pytest.mark.skipif(total_memory() < 4 << 30, reason="it needs addresses for 2 GiB")
def test_matrices_of_two_gigabytes_have_as_many_bytes():
    """Of one of 16,384 unknowns the number of bytes is beyond 32 bits; it isn't written here."""
    n = 1 << 14
    options = {"frame": Euclidean(n), "method": "ImplicitMidpoint", "h": 0.1}
    stepper = cg.Stepper(lambda t, y: -y, 0.0, np.ones(n), **options)
    assert stepper._run.record.state_size > 8 * n**2 >= 2**31

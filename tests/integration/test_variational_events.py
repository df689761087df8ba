"""Derivatives of solutions with events, of event times, of ensembles, and with noise."""

from types import SimpleNamespace

import numpy as np
import pytest
from refusals import refuses
from waves import TIGHT

import cg
from cg.frames import SO3, Euclidean, PhaseSpace

GRAVITY = 9.81


def test_an_event_that_only_touches_has_no_derivative():
    options = {"frame": Euclidean(1), "t_span": (0, 1), "y0": [1.0], "h": 0.25, "method": "CG4a"}
    solution = cg.solve_variational(
        lambda t, y: [1.0], events=lambda t, y: (y[0] - 1.5) ** 3, **options
    )
    assert solution.t_events[0].tolist() == [0.5]
    assert not np.isfinite(solution.dt_events[0]).any()
    stuck = cg.Event(lambda t, y: (t - 0.5) ** 3, jump=lambda t, y: y)
    with pytest.raises(ValueError, match=r"events\[0\] must change its sign .* is 0 at t = 0.5"):
        cg.solve_variational(lambda t, y: [0.0], events=stuck, **options)


def test_large_derivatives_do_not_hide_small_bounces():
    """The derivative of the last coordinate grows to 5e11; the ball jumps by 1e-10."""
    floor = cg.Event(
        lambda t, y: y[0], direction=-1, jump=lambda t, y: np.array([0.0, -1e-5 * y[1], y[2]])
    )
    arguments = lambda t, y: [y[1], -GRAVITY, 60.0 * y[2]], (0.0, 0.451533), [1.0, 0.0, 0.0]
    options = {"frame": Euclidean(3), "events": floor, **TIGHT}
    alone = cg.solve_ivp(*arguments, **options)
    solution = cg.solve_variational(*arguments, **options)
    assert alone.t_events[0].size >= 2
    np.testing.assert_allclose(solution.t_events[0], alone.t_events[0], rtol=0, atol=1e-15)


@pytest.mark.parametrize("span", [(0.0, 1e-6), (1e-6, 0.0)])
@pytest.mark.parametrize("place", [0.001, 0.1, 0.5, 0.999])
def test_differences_stay_within_the_times_of_inputs(span, place):
    """Also where an event is near one of their ends: y' = p u, an event at a time and a jump."""
    samples = cg.Samples([0.0, 1e-6], [1e6, 1e6], "linear")
    at = 1e-6 * place
    event = cg.Event(lambda t, y, u, p: t - at, jump=lambda t, y, u, p: 2.0 * y)
    solution = cg.solve_variational(
        lambda t, y, u, p: p * u, span, [1.0], frame=cg.frames.Euclidean(1), inputs=samples,
        parameters=[0.5], events=event, rtol=1e-9, atol=1e-9, control_derivatives=True,
    )  # fmt: skip
    assert len(solution.t_events[0]) == 1
    np.testing.assert_allclose(solution.dt_events[0], 0.0, atol=1e-20)
    np.testing.assert_allclose(solution.transition[-1], 2.0, rtol=3e-12)
    expected = 1.0 + place if span[1] > span[0] else place - 2.0  # doubled at the jump
    np.testing.assert_allclose(solution.sensitivity[-1].item(), expected, rtol=2e-10)


@pytest.mark.parametrize("start", [0.0, 1e5])
@pytest.mark.parametrize("kind", ["cubic", "hold"])
def test_event_times_have_derivatives_at_late_times_and_near_jumps_of_inputs(start, kind):
    times = start + np.linspace(0.0, 1.0, 5)
    inputs = cg.Samples(times, [0.0, -0.3, 0.6, 0.1, 0.2], kind)
    at = start + 0.5 + 1e-3 * (kind == "hold")  # the value of a held input is another before
    solution = cg.solve_variational(
        lambda t, y, u: [0.0], (start, start + 1.0), [1.0], frame=Euclidean(1), inputs=inputs,
        events=lambda t, y, u: y[0] + 9.0 * u * (t - at) - 1.0,
    )  # fmt: skip
    (index,) = np.flatnonzero(abs(solution.t_events[0] - at) < 1e-6)
    np.testing.assert_allclose(solution.dt_events[0][index], -1.0 / 5.4, rtol=1e-6)


@pytest.mark.parametrize("steps", [{"h": 0.05, "method": "CF4"}, {"rtol": 1e-7, "atol": 1e-9}])
@pytest.mark.parametrize("kind", ["hold", "linear", "cubic"])
def test_members_with_times_of_their_own_have_derivatives_as_alone(kind, steps):
    """An input turns just before an event, and differences by time don't reach over that corner."""

    def samples(corner):
        times, values = [0.0, 0.2, corner, 1.5], [1.0, 1.4, 0.7, 2.0]
        if kind == "cubic":
            times, values = np.linspace(0.0, 1.5, 7), np.sin(np.arange(7.0) * (1 + corner))
        return cg.Samples(times, values, kind)

    def f(t, y, u):
        return [u, np.sin(t)]

    inner = cg.Event(
        lambda t, y, u: t + 1e-4 * y[0] - 0.6, direction=1, jump=lambda t, y, u: [y[0] + u**2, t]
    )
    options = {"frame": Euclidean(2), "events": inner, "derivatives": "forward", **steps}
    points = np.array([[0.0, 0.1], [0.2, 0.3], [-0.1, 0.2]])
    inputs = [samples(corner) for corner in (0.6, 0.4, 0.5995)]
    together = cg.solve_ensemble(
        f, (0, 1), points, inputs=inputs, t_eval=[0.0, 0.5, 1.0], P0=0.1 * np.eye(2), **options
    )
    for k, (y0, curve) in enumerate(zip(points, inputs, strict=True)):
        alone = cg.solve_ivp(
            f, (0, 1), y0, inputs=curve, t_eval=[0.0, 0.5, 1.0], P0=0.1 * np.eye(2), **options
        )
        assert alone.t_events[0].size == 1
        np.testing.assert_array_equal(together[k].y, alone.y)
        np.testing.assert_array_equal(together[k].transition, alone.transition)
        np.testing.assert_array_equal(together[k].covariance, alone.covariance)
        np.testing.assert_array_equal(together[k].dt_events[0], alone.dt_events[0])


@pytest.mark.filterwarnings("ignore:Failure of")
def test_members_that_fail_are_nan():
    f = lambda t, y, p: [p[0] * y[0] ** 2]
    solution = cg.solve_variational_ensemble(
        f, (0, 2), [1.0], frame=Euclidean(1), parameters=[[0.25], [1.0]], t_eval=[0.5, 2.0]
    )
    assert solution.status.tolist() == [0, -1]
    assert np.isfinite(solution.transition[:, 0]).all()
    assert np.isnan(solution.transition[1, 1])
    assert solution[1].transition.shape == (1, 1, 1)
    np.testing.assert_allclose(solution.transition[0, 0], 1 / (1 - 0.125) ** 2, rtol=1e-6)


NODES, WEIGHTS = np.polynomial.legendre.leggauss(40)


def quadrature(sol, density):
    """Return the integral of the propagated density from 0 to 1."""
    times, total = (NODES + 1) / 2, 0.0
    for t, y, phi, weight in zip(times, sol(times), sol.transition(times), WEIGHTS, strict=True):
        move = sol.transition(1.0) @ np.linalg.inv(phi)
        total += weight / 2 * move @ density(t, y) @ move.T
    return total


def test_noise_on_a_phase_space():
    frame = PhaseSpace(SO3(), inertia=[1.0, 1.6, 2.3])
    y0 = frame.join(np.eye(3), [0.1, 0.2, 0.3])
    g = np.random.default_rng(0).standard_normal((6, 6)) / 2
    density = lambda t, y: g @ g.T * np.exp(0.6 * t + y[0])
    q = density(0.0, np.zeros(1))
    for noise, function in ((q, lambda t, y: q), (density, density)):
        run = cg.solve_variational(
            lambda t, y: [np.sin(t), 0.1 * y[0], 0.2], (0, 1), y0, frame=frame, noise=noise,
            control_derivatives=True, dense_output=True, **TIGHT,
        )  # fmt: skip
        expected = quadrature(run.sol, function)
        np.testing.assert_allclose(run.covariance[-1], expected, rtol=0, atol=8e-12)


def test_a_compiled_density(affine_rhs):
    """It gives the numbers of one in Python, and is checked at the start."""
    constant, slope = np.diag([1.0, 2.0]), np.array([[0.5, 0.1], [0.1, 0.5]])
    linear = np.zeros((4, 2))

    def solve(noise):
        return cg.solve_variational(
            lambda t, y: [y[1], -np.sin(y[0])], (0, 1), [1.0, 0.0], frame=Euclidean(2),
            noise=noise, **TIGHT,
        )  # fmt: skip

    compiled, _data = affine_rhs(SimpleNamespace(constant=constant.ravel(), slope=slope.ravel(),
                                             linear=linear))  # fmt: skip
    expected = solve(lambda t, y: constant + t * slope)
    np.testing.assert_array_equal(solve(compiled).covariance, expected.covariance)
    wrong, _kept = affine_rhs(SimpleNamespace(constant=-constant.ravel(), slope=slope.ravel(),
                                          linear=linear))  # fmt: skip
    refuses(ValueError, "noise must be positive semidefinite", solve, wrong)


@pytest.mark.parametrize(("noise", "message"), [
    (np.eye(2), r"noise must have shape \(3, 3\), got \(2, 2\)"),
    (-np.eye(3), "noise must be positive semidefinite, got one with the eigenvalue -1"),
    (np.triu(np.ones((3, 3))), "noise must be symmetric"),
    (lambda t, y: np.eye(2), r"noise must return an array of shape \(3, 3\), got shape \(2, 2"),
    (lambda t, y: (0.5 - t) * np.eye(3),
     r"noise must be positive semidefinite, .* at t = 0\.[5-9]"),
    (lambda t, y: np.tri(3), "noise must be symmetric, .* at t = 0"),
    (lambda t, y: np.full((3, 3), np.nan), "noise must return finite numbers"),
    ("x", "noise must be an array of real numbers, got 'x'"),
])  # fmt: skip
def test_bad_noise_is_refused(noise, message):
    with pytest.raises(ValueError, match=message):
        cg.solve_variational(
            lambda t, y: [1.0, 0.0, t], (0, 1), np.eye(3), frame=SO3(), noise=noise, rtol=1e-6
        )


@pytest.mark.parametrize("noise", [[[2.0]], lambda t, y: [[2.0]]])
@pytest.mark.parametrize("solve", [cg.solve_variational, cg.solve_variational_ensemble])
@pytest.mark.parametrize("t_eval", [None, [0.5]])
def test_noise_backward_in_time_is_refused(solve, noise, t_eval):
    y0 = [1.0] if solve is cg.solve_variational else [[1.0], [2.0]]
    refuse = pytest.raises(ValueError, match=r"noise must be None backward in time.*\(1\.0, 0\.0\)")
    with refuse:
        solve(lambda t, y: -y, (1, 0), y0, frame=cg.frames.Euclidean(1), noise=noise, t_eval=t_eval)


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("how", ["input", "breakpoint"])
def test_an_event_where_an_input_jumps_over_zero_stays_there(how, sign):
    """The function y - u jumps from -9 to 11 at t = 1, or backward from 9 to -11."""
    samples = cg.Samples([0.0, 1.0, 2.0], [10.0, -10.0, -10.0], "hold")
    steps = lambda t: 10.0 if t < 1.0 else -10.0
    function = {"input": lambda t, y, u: y[0] - u, "breakpoint": lambda t, y: y[0] - steps(t)}[how]
    given = {"input": {"inputs": samples}, "breakpoint": {"breakpoints": [1.0]}}[how]
    span = (0.0, 2.0) if sign > 0 else (2.0, 0.0)
    jump = cg.Event(function, jump=lambda t, y, *u: 2.0 * y + 100.0 * sign + np.sin(t))
    options = {"frame": Euclidean(1), "derivatives": "forward", "rtol": 1e-8, "atol": 1e-8, **given}
    solution = cg.solve_ivp(lambda t, y, *u: [1.0], span, [0.0], events=jump, **options)
    np.testing.assert_allclose(solution.t_events[0], [1.0], rtol=1e-14)
    np.testing.assert_array_equal(solution.dt_events[0], [[0.0]])
    np.testing.assert_allclose(solution.transition[-1], [[2.0]], rtol=1e-9)
    ends = cg.Event(function, terminal=True)
    solution = cg.solve_ivp(lambda t, y, *u: [1.0], span, [0.0], events=ends, **options)
    np.testing.assert_array_equal(solution.dt_events[0], [[0.0]])
    np.testing.assert_allclose(solution.transition[-1], [[1.0]], rtol=1e-9)

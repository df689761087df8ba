"""Spans without an end, tolerances of each coordinate, constant Jacobians."""

import numpy as np
import pytest
from refusals import refuses
from scipy.sparse import csc_array

import cg
from cg.frames import SO3, Euclidean, Product, Sphere, UnitQuaternion

GROWS = {"rtol": 1e-9, "atol": 1e-9, "frame": Euclidean(1)}


def grow(t, y):
    return y


def at_ten(t, y):
    return y[0] - 10.0


at_ten.terminal = True


class TestEndless:
    @pytest.mark.parametrize("sign", [1, -1])
    def test_a_terminal_event_ends_it(self, sign):
        progress = []
        run = cg.solve_ivp(
            lambda t, y: sign * y, (0, sign * np.inf), [1.0], events=at_ten, dense_output=True,
            breakpoints=[sign * 1.0], progress=lambda *x: progress.append(x), **GROWS,
        )  # fmt: skip
        assert run.status == 1
        assert np.allclose(run.t[-1], sign * np.log(10), rtol=0.0, atol=1e-10)
        assert sign * 1.0 in run.t
        assert np.allclose(run.sol(sign * 2.0), np.exp(2.0), rtol=0.0, atol=5e-10)
        assert progress[-1][1] == np.inf

    @pytest.mark.parametrize("sign", [1, -1])
    @pytest.mark.parametrize("method", ["auto", "CF4(3)", "RadauIIA5"])
    def test_the_last_numbers_end_it(self, sign, method):
        calls, span, options = [], (0, sign * np.inf), {"events": at_ten, "method": method, **GROWS}
        rest = lambda t, y: calls.append(t) or 0.0 * y
        alone = cg.solve_ivp(rest, span, [1.0], **options)
        assert (alone.status, alone.y[-1].tolist()) == (-1, [1.0])
        assert "there was no terminal event up to t" in alone.message
        assert abs(alone.t[-1]) > 1e300
        for common in (False, True):
            with pytest.warns(UserWarning, match="no terminal event up to t"):
                members = cg.solve_ensemble(
                    rest, span, [[1.0], [2.0]], common_steps=common, **options
                )
            assert members.status.tolist() == [-1, -1]
        stepper = cg.Stepper(rest, 0.0, [1.0], t_bound=span[1], **options)
        while stepper.status == "running":
            end = stepper.step()
        assert stepper.status == "failed"
        assert "no terminal event up to t" in end
        assert len(calls) < 50_000

    @pytest.mark.parametrize("events", [None, [], cg.Event(at_ten.__call__)])
    @pytest.mark.parametrize("end", [np.inf, -np.inf])
    def test_it_is_refused_without_a_terminal_event(self, end, events):
        with pytest.raises(ValueError, match="events must hold a terminal one if t_span has no"):
            cg.solve_ivp(grow, (0, end), [1.0], events=events, **GROWS)

    @pytest.mark.parametrize("sign", [1, -1])
    @pytest.mark.parametrize(
        "frame", [SO3(), Product(SO3(), Euclidean(1)), UnitQuaternion()], ids=repr
    )
    def test_steps_that_turn_take_no_more_calls_of_events(self, frame, sign):
        """Nor are steps rejected, since they end before the pole of dexp^-1."""
        calls = []
        never = cg.Event(lambda t, y: calls.append(t) or 1.0 + y.flat[0] ** 2, terminal=True)
        f = lambda t, y: [0.1, 0.3, 1.0, 0.0][: frame.dim]
        y0 = frame.random_point(np.random.default_rng(0))
        options = {"frame": frame, "events": never}
        counts = []
        for steps in (20, 40, 60):
            calls.clear()
            run = cg.solve_ivp(f, (0, sign * np.inf), y0, max_steps=steps, **options)
            counts.append(len(calls))
        assert (run.status, run.nrejected) == (-1, 0)
        assert counts[2] - counts[1] <= 1.2 * (counts[1] - counts[0]) < 20 * 40

    @pytest.mark.parametrize("frame", [SO3(), Sphere(3)], ids=repr)
    def test_steps_turn_once_at_most_in_any_unit_of_time(self, frame):
        """Also after a breakpoint, and steps of an ensemble."""
        space = Product(frame, Euclidean(1))
        turn, move = 1e6 * np.eye(space.dim)[-2], 1e9 * np.eye(space.dim)[-1]
        f = lambda t, y: move + (turn if t >= 1.0 else 0.0)
        y0 = space.join([np.eye(3), np.eye(4)[0]][frame.dim > 3], [0.0])
        seventh = cg.Event(lambda t, y: y[0] + 0.9, direction=-1, terminal=7)
        options = {"frame": space, "events": seventh, "breakpoints": [1.0]}
        run = cg.solve_ivp(f, (0, np.inf), y0, **options)
        assert run.steps < 30
        both = cg.solve_ensemble(f, (0, np.inf), [y0, y0], common_steps=True, **options)
        for times in (run.t_events[0], *both.t_events[0]):
            angle = 1e6 * (times[-1] - 1.0)
            assert np.allclose(angle, 12 * np.pi + np.arccos(-0.9), rtol=0.0, atol=1e-5)


class TestRelativeTolerances:
    def test_a_coordinate_with_a_loose_one_is_less_accurate(self):
        def solve(rtol):
            frame = Euclidean(2)
            rates = np.array([1.0, 4.0])
            f = lambda t, y: y * np.cos(rates * t)
            return cg.solve_ivp(f, (0, 9), [1, 1], frame=frame, rtol=rtol)

        loose = solve([1e-4, 1e9])
        assert loose.steps < solve(1e-4).steps < solve([1e-4, 1e-9]).steps

    def test_variational_equations_keep_the_smallest(self):
        options = {"frame": Euclidean(2), "rtol": [1e-4, 1e-8], "atol": 1e-9}
        problem = (lambda t, y: [y[1], -y[0]], (0, 3), [1.0, 0.0])
        solution = cg.solve_variational(*problem, **options)
        assert np.abs(solution.y[-1] - [np.cos(3), -np.sin(3)]).max() < 1e-9

    def test_a_tiny_one_is_raised(self):
        with pytest.warns(UserWarning, match="At least one element of rtol is too small"):
            cg.solve_ivp(grow, (0, 1), [1.0], frame=Euclidean(1), rtol=[1e-20])


class TestConstantJacobian:
    MATRIX = np.array([[-1e3, 1.0], [0.0, -1.0]])

    def solve(self, jac, **options):
        options = {"frame": Euclidean(2), "method": "RadauIIA5", **options}
        return cg.solve_ivp(lambda t, y: self.MATRIX @ y, (0, 1), [1.0, 1.0], jac=jac, **options)

    @pytest.mark.parametrize("convert", [np.asarray, np.ndarray.tolist, csc_array])
    def test_it_is_not_counted(self, convert):
        reference = self.solve(lambda t, y: self.MATRIX)
        run = self.solve(convert(self.MATRIX))
        assert reference.njev > 0 == run.njev
        assert np.allclose(run.y, reference.y, rtol=0.0, atol=1e-11)

    @pytest.mark.parametrize("convert", [np.asarray, csc_array, lambda m: lambda *_: csc_array(m)])
    def test_it_serves_for_derivatives(self, convert):
        reference, run = (
            self.solve(jac, derivatives="forward", rtol=1e-6)
            for jac in (lambda t, y: self.MATRIX, convert(self.MATRIX))
        )
        assert np.array_equal(run.transition, reference.transition)

    def test_another_shape_is_refused(self):
        message = r"jac must have shape \(2, 2\), got \(3, 3\)"
        for matrix in (np.eye(3), np.eye(3).tolist(), csc_array(np.eye(3))):
            refuses(ValueError, message, self.solve, matrix)
            refuses(ValueError, message, self.solve, matrix, derivatives="forward")
        refuses(ValueError, "jac must be an array of real", self.solve, [[1.0], [1.0, 2.0]])


@pytest.mark.parametrize("method", ["CF5(4)", "RKMK5(4)", "CG5(4)"])
def test_adaptive_steps_turn_far_while_coefficients_change_by_less_than_the_tolerance(method):
    """A change of one of three coefficients is the root of three times as large as its norm."""
    for change, steps in ((1.6e-6, 1), (1.9e-6, 3)):
        run = cg.solve_ivp(
            lambda t, y, c=change: [0.0, 0.0, 1e3 + c * t], (0, 1), np.eye(3), frame=SO3(),
            method=method, rtol=1e-12, atol=1e-6, first_step=1.0,
        )  # fmt: skip
        assert run.steps == steps


def test_kinks_without_breakpoints():
    """The data are interpolated linearly."""
    times = np.linspace(0.0, 1.0, 301)
    rates = np.random.default_rng(1).standard_normal((3, len(times)))

    f = lambda t, y: [np.interp(t, times, row) for row in rates]
    options = {"frame": SO3(), "method": "RKMK8(5,3)", "rtol": 1e-11, "atol": 1e-11}
    with pytest.warns(UserWarning, match="name them as breakpoints") as caught:
        poor = cg.solve_ivp(f, (0, 1), np.eye(3), **options)
    assert caught[0].filename == __file__
    good = cg.solve_ivp(f, (0, 1), np.eye(3), breakpoints=times, **options)
    assert good.nrejected == 0
    assert good.nfev < 0.5 * poor.nfev
    assert np.isin(times, good.t).all()


def test_derivatives_far_from_time_zero_take_no_more_steps():
    f = lambda t, y: np.array([np.sin(t + y[0, 1]), 0.3 * y[1, 2], np.cos(1.3 * t + y[2, 0])])
    options = {"events": cg.Event(lambda t, y: t - 1e6 - 20.0, terminal=True), "rtol": 1e-6}
    run = cg.solve_variational(f, (1e6, np.inf), np.eye(3), frame=SO3(), atol=1e-6, **options)
    assert run.steps < 200  # one-sided differences would be noise

"""The stepper: single steps, restarts, copies and pickles."""

import copy
import ctypes

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from refusals import refuses
from right_hand_sides import OPTIONS, turning
from scipy import LowLevelCallable

import cg
from cg.frames import SO3, Euclidean


def test_advance_lands_on_the_time_and_does_not_shrink_the_next_step():
    without = cg.Stepper(turning, 0, np.eye(3), 9.0, frame=SO3(), method="CF5(4)", **OPTIONS)
    for _ in range(6):
        without.step()
    stepper = copy.copy(without)
    size = without.step_size
    assert (size, stepper.direction, stepper.n) == (stepper.t - stepper.t_old, 1.0, 3)
    assert stepper.advance(stepper.t + 1e-3 * size) is None
    assert stepper.step_size == pytest.approx(1e-3 * size, abs=2e-15)
    stepper.step()
    assert stepper.step_size > 0.5 * size
    refuses(ValueError, "t must lie between", stepper.advance, 0.0)
    refuses(ValueError, "t must lie between", stepper.advance, 9.5)
    assert stepper.advance(9.0) is None
    assert (stepper.t, stepper.status) == (9.0, "finished")
    refuses(RuntimeError, "has finished", stepper.step)


@pytest.mark.parametrize("end", [9.0, -9.0])
@pytest.mark.parametrize("members", [(), (2,)])
def test_a_limit_lies_beyond_the_time(end, members):
    options = {"frame": Euclidean(1), "common_steps": bool(members), "first_step": 1e-3}
    stepper = cg.Stepper(lambda t, y: -y, 0.0, np.ones((*members, 1)), end, **options)
    for _ in range(2):
        t, steps = stepper.t, stepper.nfev
        refuses(ValueError, "limit must lie beyond t = .* got", stepper.step, t)
        refuses(ValueError, "limit must lie between", stepper.step, t - 1e-6 * end)
        assert stepper.advance(t) is None
        assert (stepper.t, stepper.nfev) == (t, steps)
        assert stepper.step(t + 1e-6 * end) is None
        assert stepper.t == t + 1e-6 * end


@pytest.mark.parametrize("options", [{"first_step": 0.01}, {"max_step": 0.01}])
def test_a_step_that_ends_within_rounding_of_a_time_ends_there(options):
    stepper = cg.Stepper(turning, 0.0, np.eye(3), frame=SO3(), method="CF5(4)", **options)
    counts = []
    for k in range(1, 201):
        stepper.restart(y=stepper.y)
        before = stepper.nfev
        stepper.advance(k * 0.01)
        counts.append(stepper.nfev - before)
    assert stepper.t == 2.0
    assert len(set(counts[1:])) == 1


@pytest.mark.parametrize("error", [KeyError, KeyboardInterrupt])
@pytest.mark.parametrize("calls", [1, 9, 14, 23])
@pytest.mark.parametrize("control", [{"method": "CF4", "h": 0.1}, {"method": "CF5(4)", **OPTIONS}])
def test_a_stepper_goes_on_after_an_exception(control, calls, error):
    """f fails once; the next call takes the same steps as without the failure."""
    left = [calls]

    def f(t, y):
        left[0] -= 1
        if left[0] == 0:
            raise error("once")
        return turning(t, y)

    stepper, without = (cg.Stepper(g, 0.0, np.eye(3), frame=SO3(), **control) for g in (f, turning))
    refuses(error, "once", stepper.advance, 2.0)
    while without.t < stepper.t:
        without.step()
    assert (stepper.t, stepper.t_old) == (without.t, without.t_old)
    assert_array_equal(stepper.y, without.y)
    stepper.advance(2.0)
    without.advance(2.0)
    assert_allclose(stepper.y, without.y, rtol=0, atol=1e-14)
    stepper.restart(t=0.0, y=np.eye(3))
    stepper.advance(2.0)
    assert_allclose(stepper.y, without.y, rtol=0, atol=2e-14)


def test_a_function_that_ends_is_named_backward_in_time_too():
    f = lambda t, y: [1.0 if t >= -1.0 else np.nan]
    stepper = cg.Stepper(f, 0.0, [0.0], -2.0, frame=Euclidean(1))
    assert "f must return finite numbers next to t" in stepper.advance(-2.0)


def test_equal_steps_that_the_time_cannot_resolve_are_refused():
    options = {"frame": Euclidean(1), "method": "CF4", "h": 1e-3}
    match = r"h must change the time at t = 1000000000000000.0, got 0.001"
    refuses(ValueError, match, cg.Stepper, lambda t, y: [1.0], 1e15, [0.0], **options)
    stepper = cg.Stepper(lambda t, y: [1.0], 0.0, [0.0], **options)
    refuses(ValueError, match, stepper.advance, 1e15)
    refuses(ValueError, match, stepper.restart, t=1e15)
    refuses(ValueError, "first_step must be None with h", stepper.restart, first_step=0.05)
    assert stepper.t == 0.0


def test_a_refused_restart_changes_nothing():
    def f(t, y, rate):
        return rate[0] * y

    stepper = cg.Stepper(f, 0.0, [1.0], 9.0, frame=Euclidean(1), parameters=[1.0], **OPTIONS)
    stepper.advance(1.0)
    state, y = (stepper.t, stepper.t_old, stepper.status), stepper.y
    for wrong, match in (
        ({"y": [np.nan]}, "y must be finite"),
        ({"y": [1.0, 2.0]}, "y must have shape"),
        ({"y": [0.0], "parameters": [np.nan, "a"]}, "parameters must be"),
        ({"y": [0.0], "parameters": [1.0, 2.0]}, r"parameters must have shape \(1,\), got \(2,\)"),
        ({"y": [0.0], "args": 3.0}, "args must be a tuple"),
        ({"y": [0.0], "first_step": -1.0}, "first_step must be"),
        ({"parameters": [2.0], "args": 3.0}, "args must be a tuple"),
    ):
        refuses((ValueError, TypeError), match, stepper.restart, t=5.0, **wrong)
        assert (stepper.t, stepper.t_old, stepper.status) == state
        assert_array_equal(stepper.y, y)
    stepper.restart()
    refuses(RuntimeError, "dense_output must come after a step", stepper.dense_output)
    stepper.advance(2.0)
    assert stepper.y == pytest.approx(np.exp(2.0), rel=5e-9)
    without = cg.Stepper(turning, 0.0, np.eye(3), frame=SO3())
    refuses(ValueError, "parameters must be None, as before", without.restart, parameters=[1.0])
    refuses(ValueError, "y must be a point", without.restart, y=2 * np.eye(3))


@pytest.mark.parametrize("method", ["DP5(4)", "RKMK8(5,3)", "RadauIIA5"])
def test_a_restart_reads_data_that_have_changed_in_place(method):
    kind = ctypes.CFUNCTYPE(ctypes.c_int, ctypes.c_double, *[ctypes.POINTER(ctypes.c_double)] * 3)
    rate = np.array([1.0])

    @kind
    def f(t, y, out, data):
        out[0] = data[0] * y[0]
        return 0

    address = ctypes.cast(rate.ctypes.data, ctypes.c_void_p)
    given = {"frame": Euclidean(1), "method": method, "rtol": 1e-6, "atol": 1e-6}
    stepper = cg.Stepper(LowLevelCallable(f, address), 0.0, [1.0], **given)
    stepper.advance(1.0)
    rate[0] = -2.0
    stepper.restart()
    new = cg.Stepper(LowLevelCallable(f, address), 1.0, stepper.y, **given)
    for each in (stepper, new):
        each.advance(2.0)
    assert stepper.y == new.y


class TestDataChecks:
    @pytest.mark.parametrize(("change", "message"), [
        ({"parameters": [np.nan]}, r"parameters must be finite, got nan at \[0\]"),
        ({"t": 0.5}, "t must lie within the times of the samples, 1 to inf, got 0.5"),
    ])  # fmt: skip
    def test_what_f_cannot_take_is_refused(self, change, message):
        given = {
            "frame": Euclidean(1), "args": (1.0,), "parameters": [2.0],
            "inputs": cg.Samples([1.0, 2.0], [0.0, 1.0]),
        }  # fmt: skip
        f = lambda t, y, u, a, p: [u + a + p[0]]
        stepper = cg.Stepper(f, 1.0, [1.0], **given)
        refuses((TypeError, ValueError), message, stepper.restart, **change)
        assert stepper.step() is None
        if "t" not in change:
            refuses((TypeError, ValueError), message, cg.Stepper, f, 1.0, [1.0], **given | change)

    def test_forces_that_get_friction_are_refused(self):
        frame = cg.frames.PhaseSpace(cg.frames.Euclidean(1))
        stepper = cg.Stepper(
            lambda t, y, c: -y[:1] - c * y[1:], 0.0, [1.0, 0.5], frame=frame, method="Leapfrog",
            h=0.1, args=(0.0,),
        )  # fmt: skip
        refuses(ValueError, "f must not depend on the momentum", stepper.restart, args=(0.1,))
        assert stepper.step() is None


@pytest.mark.parametrize("move", [0.0, 1e-7])
def test_points_replaced_after_each_step_keep_the_jacobian(move):
    """A filter or a projection moves points by less than a step does; f is stiff."""

    def f(t, y):
        return [y[1], 1e3 * (1.0 - y[0] ** 2) * y[1] - y[0]]

    def end(moves, tol=1e-6):
        stepper = cg.Stepper(f, 0.0, [2.0, 0.0], 1500.0, frame=Euclidean(2), method="RadauIIA5",
                             rtol=tol, atol=tol)  # fmt: skip
        while stepper.status == "running":
            assert stepper.step() is None
            if moves and stepper.status == "running":
                stepper.restart(y=stepper.y * [1.0 + move, 1.0])
                stepper = copy.copy(stepper)
        return stepper

    plain, moved = end(False), end(True)
    assert moved.nfev < 1.2 * plain.nfev
    assert moved.njev < 1.5 * plain.njev
    if not move:
        assert_allclose(moved.y, end(False, 1e-9).y, rtol=1e-4)


def test_jacobians_of_another_f_are_forgotten():
    """Relaxation ever faster or slower, by the same Jacobian, lost hundreds of tolerances."""

    def f(t, y, rate):
        return [-rate * (y[0] - np.cos(t)) + y[1], -y[0] - 0.1 * y[1]]

    def end(tol):
        stepper = cg.Stepper(f, 0.0, [1.0, 0.0], 20.0, frame=Euclidean(2), method="RadauIIA5",
                             rtol=tol, atol=tol, args=(1e3,))  # fmt: skip
        for k in range(1, 20):
            stepper.advance(float(k))
            stepper.restart(args=(1e3 if k % 2 else 1.0,), y=stepper.y)
        stepper.advance(20.0)
        return stepper.y

    assert_allclose(end(1e-4), end(1e-10), rtol=0, atol=2e-5)


def test_steps_that_begin_with_a_drift_need_no_force_at_their_start():
    frame = cg.frames.PhaseSpace(SO3(), 1.0)
    options = {"frame": frame, "h": 0.1, "method": "McLachlan2"}
    start, force = frame.join(np.eye(3), np.ones(3)), lambda t, y: y[:3] - t
    dense = cg.solve_ivp(force, (0.0, 1.0), start, dense_output=True, **options)
    stepper = cg.Stepper(force, 0.0, start, 1.0, **options)
    stepper.advance(1.0)
    assert stepper.nfev == cg.solve_ivp(force, (0.0, 1.0), start, **options).nfev
    assert_array_equal(stepper.dense_output()(0.95), dense.sol(0.95))


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_where_a_call_ends_changes_nothing_beside_breakpoints(sign):
    """RKMK5(4) evaluates f at both ends of a step, each time on its own side of a breakpoint."""
    f = lambda t, y: [0.0 if sign * t <= 1.0 else 10.0 * np.cos(t)]
    options = {"frame": Euclidean(1), "method": "RKMK5(4)", "h": 0.5}
    options["breakpoints"] = [sign, 2.0 * sign]
    expected = cg.integrate(f, (0.0, 3.0 * sign), [0.0], **options).y[-1]
    for looks in (False, True):
        stepper = cg.Stepper(f, 0.0, [0.0], 3.0 * sign, **options)
        for time in (1.5, 2.0, 2.5, 3.0):
            stepper.advance(time * sign)
            if looks:
                stepper.dense_output()
        assert_allclose(stepper.y, expected, rtol=1e-14)


@pytest.mark.parametrize("name", [n for n in cg.methods if not 0 <= min(cg.methods[n].c)
                                  <= max(cg.methods[n].c) <= 1 + 1e-15])  # fmt: skip
def test_methods_with_stages_outside_the_step_are_refused_with_breakpoints(name):
    """Stages beyond a breakpoint would get f at it: CF6d has order two there."""
    options = {"frame": Euclidean(1), "method": name, "h": 0.5}
    f, message = lambda t, y: y, "method must evaluate f within the step with breakpoints"
    for inside in ([0.25], [0.5, 2.0]):
        options["breakpoints"] = inside
        refuses(ValueError, message, cg.solve_ivp, f, (0.0, 3.0), [1.0], **options)
        refuses(ValueError, message, cg.solve_ensemble, f, (0.0, 3.0), [[1.0]], **options)
        refuses(ValueError, message, cg.Stepper, f, 0.0, [1.0], **options)
    options["breakpoints"] = [0.0, 3.0]  # the ends of the span
    assert cg.solve_ivp(f, (0.0, 3.0), [1.0], **options).success


def test_the_step_after_a_breakpoint_has_the_forces_behind_it():
    """In `dense_output` too, of a method that doesn't evaluate them at the start of a step."""
    frame, force = cg.frames.PhaseSpace(Euclidean(1)), lambda t, q: [0.0 if t <= 1.0 else 10.0]
    options = {"frame": frame, "method": "McLachlan2", "h": 0.5, "breakpoints": [1.0]}
    dense = cg.solve_ivp(force, (0.0, 3.0), [0.0, 0.0], dense_output=True, **options)
    stepper = cg.Stepper(force, 0.0, [0.0, 0.0], 3.0, **options)
    stepper.advance(1.0)
    stepper.step()
    assert_array_equal(stepper.dense_output()(1.25), dense.sol(1.25))
    assert_allclose(dense.sol(1.25), [0.3125, 2.5], rtol=1e-12)


@pytest.mark.parametrize("method", ["RKMK4", "RadauIIA5", "CF4", "ImplicitMidpoint"])
def test_a_step_that_fails_leaves_no_solution_within_the_last(method):
    """Its stages are where the interpolant of the last step would have been made of its own."""
    f = lambda t, y: [1.0 / 0.0] if t > 0.65 else [np.cos(5.0 * t) * y[0]]
    stepper = cg.Stepper(f, 0.0, [1.0], 2.0, frame=Euclidean(1), method=method, h=0.2)
    stepper.advance(0.6)
    stepper.dense_output()
    with pytest.raises(ZeroDivisionError):
        stepper.step()
    refuses(RuntimeError, "dense_output must come after a step", stepper.dense_output)


def test_an_interpolant_that_cannot_be_made_says_why():
    f = lambda t, y: [1.0 if t < 0.75 else np.nan]
    stepper = cg.Stepper(f, 0.0, [1.0], 2.0, frame=Euclidean(1), method="ImplicitMidpoint", h=0.4)
    stepper.advance(0.8)
    refuses(RuntimeError, "no solution within the last step: f must ret", stepper.dense_output)
    assert (stepper.t, stepper.status) == (0.8, "running")


COUNTS = ("nfev", "nexp", "njev", "nlu", "nrejected")


def broken(t, y):
    """A rate with jumps that steps have to find."""
    return [np.sign(np.sin(5.0 * t)), 0.3 * np.cos(9.0 * t), y[0, 1]]


def van_der_pol(t, y):
    return [y[1], 200.0 * (1.0 - y[0] ** 2) * y[1] - y[0]]


RUNS = {
    **{name: (broken, np.eye(3), 3.0, {"method": name, "frame": SO3()})
       for name in ("auto", "CF5(4)", "RKMK5(4)", "DICG3(2)", "RadauIIA5")},
    "stiff": (van_der_pol, [2.0, 0.0], 200.0, {"method": "RadauIIA5", "frame": Euclidean(2)}),
}  # fmt: skip


@pytest.mark.parametrize("direction", [1.0, -1.0])
@pytest.mark.parametrize("name", RUNS)
def test_copies_of_each_step_take_the_steps_of_one_run(name, direction):
    """Near jumps and in stiff equations, where sizes depend on what earlier steps have seen."""
    f, y0, end, options = RUNS[name]
    forward = (lambda t, y: -np.array(f(-t, y))) if direction < 0 else f
    stepper = cg.Stepper(forward, 0.0, y0, direction * end, rtol=1e-5, atol=1e-5, **options)
    twin = copy.copy(stepper)
    while stepper.status == "running":
        twin = copy.copy(twin)
        assert stepper.step() is None is twin.step()
        assert twin.t == stepper.t
        assert_array_equal(twin.next_step, stepper.next_step)
        assert_array_equal(twin.y, stepper.y)
        assert [getattr(twin, n) for n in COUNTS] == [getattr(stepper, n) for n in COUNTS]
    assert stepper.nrejected > 5

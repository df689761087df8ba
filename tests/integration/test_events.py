"""Events: location, direction, terminal counts; functions of many members at a time."""

import ctypes
import ctypes.util
import math

import numpy as np
import pytest
import scipy.integrate
from refusals import refuses
from right_hand_sides import height, solve

import cg
from cg.frames import SO3, Euclidean, UnitQuaternion

pytestmark = pytest.mark.sanitize

# frames with their identity, and the cosine of the angle of a rotation about the third axis
TURNING = pytest.mark.parametrize(("frame", "one", "cosine"), [
    (SO3(), np.eye(3), lambda t, y: y[0, 0]),
    (UnitQuaternion(), np.eye(4)[3], lambda t, q: q[3] ** 2 - q[2] ** 2),
], ids=["matrix", "quaternion"])  # fmt: skip


def marked(function=height, **attributes):
    def event(t, y):
        return function(t, y)

    for name, value in attributes.items():
        setattr(event, name, value)
    return event


@pytest.mark.parametrize(("terminal", "stop"), [
    (True, 1), (1, 1), (1.0, 1), (np.bool_(True), 1), (2, 2), (np.float64(2.0), 2),
    *((value, None) for value in (False, None, 0, 0.0, 4, 10**400)),
])  # fmt: skip
def test_terminal_events_end_the_integration(terminal, stop):
    solution = solve(marked(terminal=terminal), dense_output=True)
    assert (solution.status, solution.success) == (0 if stop is None else 1, True)
    assert len(solution.t_events[0]) == (stop or 3)
    if not terminal or terminal < 10:
        event = marked(lambda t, y: math.sin(t), terminal=terminal)
        line = (lambda t, y: [1.0], (0.1, 10.0), [0.0])
        there = scipy.integrate.solve_ivp(*line, events=event, max_step=1.0)
        assert len(there.t_events[0]) == (stop or 3)
    if stop is not None:
        assert "terminal event" in solution.message
        assert solution.t[-1] == solution.t_events[0][-1] == solution.sol.t_max
        assert solution.t[-1] == pytest.approx(stop * np.pi, abs=1e-8)
        np.testing.assert_array_equal(solution.y[-1], solution.y_events[0][-1])
        np.testing.assert_array_equal(solution.sol(solution.t[-1]), solution.y[-1])
        assert abs(height(0.0, solution.y[-1])) < 5e-15


def test_a_zero_at_the_start_or_at_a_step_is_counted_rightly():
    # A grid with steps at the zeros themselves, exactly representable.
    options = {"method": "CG4a", "h": 0.5, "rtol": None, "atol": None}
    solution = solve(lambda t, y: (t - 1.0) * (t - 2.0) * (t - 3.0), t_span=(1.0, 4.0), **options)
    np.testing.assert_array_equal(solution.t_events[0], [2.0, 3.0])


def test_a_function_far_from_zero_is_called_twice_a_step():
    calls = []

    def far(t, y):
        calls.append(t)
        return 100.0

    solution = solve(far)
    middles = 0.5 * (solution.t[:-1] + solution.t[1:])
    expected = np.sort(np.concatenate([solution.t, middles]))
    np.testing.assert_allclose(np.sort(calls), expected, rtol=1e-15)


@pytest.mark.parametrize(("value", "message"), [
    (np.nan, r"events\[1\] must return finite numbers, got nan at t = "),
    (None, r"events\[1\] must return a real number, got None"),
    ("zero", r"events\[1\] must return a real number, got 'zero'"),
    ([1.0, 2.0], r"events\[1\] must return one number, got shape \(2,\)"),
    (True, r"events\[1\] must return a real number"),
    (np.bool_(False), r"events\[1\] must return a real number"),
    (np.array(True), r"events\[1\] must return a real number"),
])  # fmt: skip
def test_bad_values_are_refused(value, message):
    refuses(ValueError, message, solve, [height, lambda t, y: value if t > 2 else 1.0])


@pytest.mark.parametrize(("name", "value", "error"), [
    *(("terminal", value, ValueError) for value in (0.5, np.inf, np.nan, -1)),
    *((name, "1", TypeError) for name in ("terminal", "direction", "period")),
    ("direction", np.nan, ValueError), ("jump", 3, TypeError), ("period", True, TypeError),
    *(("period", value, ValueError) for value in (0.0, -1.0, np.inf, np.nan)),
])  # fmt: skip
def test_bad_attributes_of_events_are_rejected(name, value, error):
    refuses(error, rf"^event\.{name} must be", cg.Event, height, **{name: value})

    event = lambda t, y: 1.0
    setattr(event, name, value)
    if name in ("terminal", "direction"):  # SciPy's
        refuses(error, rf"^events\[0\]\.{name} must be", solve, event)
    else:
        assert solve(event).success


OSCILLATOR = {"frame": Euclidean(2), "rtol": 1e-10, "atol": 1e-10}


@pytest.mark.parametrize("method", ["CG4(3)", "CG5(4)", "CG6(5)"])
@pytest.mark.parametrize(("unit", "start"), [(1.0, 0.0), (1e-12, 0.0), (1e12, 0.0), (1.0, 1.7e9)])
def test_event_times_are_as_accurate_as_the_steps_in_any_unit_of_time(method, unit, start):
    f = lambda t, y: np.array([y[1], -y[0]]) / unit
    solution = cg.solve_ivp(
        f, (start, start + 8 * unit), [1.0, 0.0], events=lambda t, y: y[0], method=method,
        **OSCILLATOR,
    )  # fmt: skip
    (times,), (points,) = solution.t_events, solution.y_events
    exact = np.pi * np.array([0.5, 1.5, 2.5])
    rounding = np.spacing(start) / unit
    np.testing.assert_allclose((times - start) / unit, exact, rtol=0, atol=2e-9 + rounding)
    np.testing.assert_allclose(points[:, 0], 0.0, rtol=0, atol=5e-15)


@pytest.mark.parametrize(
    ("multiplicity", "zero", "h"),
    # Brent's method takes 146 steps for the second, more than it is allowed by itself
    [(9, 0.45, 0.3), (3, 0.6369616873214543, 1.0), (9, 0.2697867137638703, 1.0)],
)
def test_an_event_of_odd_multiplicity_is_found(multiplicity, zero, h):
    solution = cg.solve_ivp(
        lambda t, y: [1.0], (0, 1), [0.0], frame=Euclidean(1), method="CG4a", h=h,
        events=lambda t, y: (t - zero) ** multiplicity,
    )  # fmt: skip
    assert solution.t_events[0] == pytest.approx([zero], abs=5e-15)


@pytest.mark.parametrize("depth", [1e-5, 1e-6])
def test_pairs_of_zeros_nearer_than_the_error_of_the_cubic(depth):
    run = solve(lambda t, y: y[1] - (1 - depth), (0.1, 100.0))
    tops = math.pi / 2 + 2 * math.pi * np.arange(16)
    width = math.acos(1 - depth)
    expected = np.sort(np.concatenate([tops - width, tops + width]))
    np.testing.assert_allclose(run.t_events[0], expected, rtol=0, atol=3e-5)


@TURNING
@pytest.mark.parametrize("share", [0.99, 0.999, 0.9999])
def test_narrow_pairs_of_zeros_anywhere_in_long_steps(share, frame, one, cosine):
    level = math.cos(share * math.pi)
    for middle in np.linspace(0.1, 3.9, 191):
        y0 = frame.flow([0.0, 0.0, math.pi - middle], one)
        solution = cg.solve_ivp(
            lambda t, y: [0.0, 0.0, 1.0], (0, 4), y0, frame=frame, method="CF4", h=2.0,
            events=lambda t, y: cosine(t, y) - level,
        )  # fmt: skip
        width = (1 - share) * math.pi
        expected = [middle - width, middle + width]
        np.testing.assert_allclose(solution.t_events[0], expected, rtol=0, atol=1e-11)


@TURNING
@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("steps", [{}, {"h": 8e3, "method": "CF4"}], ids=str)
def test_all_events_of_very_long_steps_are_found(steps, sign, frame, one, cosine):
    solution = cg.solve_ivp(
        lambda t, y: [0.0, 0.0, 1.0], (0, 1.6e4 * sign), one, frame=frame, events=cosine, **steps
    )
    expected = np.arange(0.5, 1.6e4 / np.pi) * np.pi  # zeros of the cosine
    np.testing.assert_allclose(sign * solution.t_events[0], expected, rtol=5e-13)


def test_a_step_that_turns_too_far_for_its_events():
    f, options = lambda t, y: [0.0, 0.0, 1.0], {"frame": SO3(), "method": "CF4", "h": 1e10}
    options["events"] = lambda t, y: y[0, 0]
    with pytest.raises(cg.StepTooLongError, match="from t = 0 is too long for its events"):
        cg.solve_ivp(f, (0, 2e10), np.eye(3), **options)
    for common in (False, True):
        with pytest.warns(UserWarning, match="too long for its events"):
            run = cg.solve_ensemble(f, (0, 2e10), np.eye(3)[None], common_steps=common, **options)
        assert not run.success
    step = cg.Stepper(f, 0.0, np.eye(3), 2e10, **options).step
    refuses(cg.StepTooLongError, "eight million turns", step)


def test_steps_grow_no_longer_than_events_allow():
    run = cg.solve_ivp(
        lambda t: [0.0, 0.0, 1.0], (0, 1e5), np.eye(3), frame=SO3(), method="CFM8(4)",
        linear=True, events=lambda t, y: y[0, 0] - 2.0,
    )  # fmt: skip
    assert (run.steps < 40, run.nrejected) == (True, 0)


def test_common_steps_that_turn_too_far_for_events_are_tried_again():
    solution = cg.solve_ensemble(
        lambda t, y, row: [0.0, 0.0, row[0]], (0, 1), np.eye(3), parameters=[[1.0], [3e4]],
        frame=SO3(), common_steps=True,
        events=cg.Event(lambda t, y, row: y[1, 0] - 0.5, direction=1),
    )  # fmt: skip
    first, second = solution.t_events[0]
    turns = 2 * np.pi * np.arange(len(second))
    np.testing.assert_allclose(first, np.pi / 6, rtol=2e-14)
    np.testing.assert_allclose(second, (np.pi / 6 + turns) / 3e4, rtol=4e-13)
    assert len(second) == int((3e4 - np.pi / 6) / (2 * np.pi)) + 1
    assert (solution.nrejected > 0).all()


def azimuth(t, y, *args):
    """The angle of a rotation about the third axis from 2 on, which wraps."""
    return math.atan2(y[1, 0], y[0, 0]) - 2.0


@ctypes.CFUNCTYPE(
    ctypes.c_double, ctypes.c_double, ctypes.POINTER(ctypes.c_double), ctypes.c_void_p
)
def compiled_azimuth(t, y, data):
    return math.atan2(y[3], y[0]) - 2.0


class TestPeriod:
    """Events on angles that wrap, of a rotation by the angle t."""

    def turn(self, span, angle=azimuth, method="auto", h=None, **event):
        event = cg.Event(angle, period=2 * np.pi, **event)
        y0 = SO3().flow([0.0, 0.0, span[0]], np.eye(3))
        options = {"frame": SO3(), "events": event, "method": method, "h": h}
        return cg.solve_ivp(lambda t, y: [0.0, 0.0, 1.0], span, y0, **options)

    @pytest.mark.parametrize(
        "steps", [{}, {"method": "CF4", "h": 1.9}, {"method": "CG3", "h": 45.0}]
    )
    @pytest.mark.parametrize("angle", [azimuth, lambda t, y: azimuth(t, y) % (2 * np.pi),
                                       lambda t, y: azimuth(t, y) - 200 * np.pi,
                                       compiled_azimuth])  # fmt: skip
    @pytest.mark.parametrize("sign", [1, -1])
    def test_crossings_are_found_and_no_wraps(self, steps, angle, sign):
        crossings = 2.0 + 2 * np.pi * np.arange(20) - (0 if sign > 0 else 40 * np.pi)
        for direction, expected in [(0, crossings), (sign, crossings), (-sign, crossings[:0])]:
            run = self.turn((0, 120 * sign), angle=angle, direction=direction, **steps)
            found = run.t_events[0]
            np.testing.assert_allclose(np.sort(found), expected[np.abs(expected) < 120], rtol=4e-13)

    def test_an_angle_that_swings(self):
        """It crosses zero, and the half period, where it wraps, in both directions."""
        for middle, count in [(0.0, 13), (np.pi, 0), (np.pi / 2, 0), (0.9, 12)]:
            run = cg.solve_ivp(
                lambda t, y: [y[1], -y[0]], (0, 40), [0.0, 1.0], frame=Euclidean(2),
                events=cg.Event(lambda t, y, c=middle: (y[0] + c) % (2 * np.pi), period=2 * np.pi),
            )  # fmt: skip
            assert len(run.t_events[0]) == count - (middle == 0)


def test_parts_of_a_linear_action_follow_the_norm_of_the_generator():
    """Twenty planes that rotate by the angle t; the norms of all sum to twenty times more."""
    generators, calls = np.zeros((20, 40, 40)), []
    for k, generator in enumerate(generators):
        generator[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] = [[0.0, -1.0], [1.0, 0.0]]

    def first(t, y):
        calls.append(t)
        return y[0]

    run = cg.solve_linear(
        lambda t: np.ones(20), (0, 100), np.tile([1.0, 0.0], 20), events=first,
        frame=cg.frames.LinearAction(list(generators)),
    )  # fmt: skip
    np.testing.assert_allclose(run.t_events[0], (np.arange(32) + 0.5) * np.pi, rtol=1e-6)
    assert len(calls) < 1500


MEMBERS = 40
RATES = np.random.default_rng(2).uniform(0.5, 3.0, (MEMBERS, 2))
UPS = np.random.default_rng(3).uniform([0.5, -2.0], [3.0, 2.0], (MEMBERS, 2))


def turning(t, y, rate):
    t = np.asarray(t)
    return np.stack([np.sin(t), 0.3 + y[..., 0, 1], t * 0 + rate[..., 0]], axis=-1)


def angle(t, y, rate):
    return np.arctan2(y[..., 1, 0], y[..., 0, 0]) - rate[..., 1]


def test_each_point_is_evaluated_once_and_points_of_many_members_together():
    sizes, points = [], []

    def many(t, y, rate):
        assert {t.flags.writeable, y.flags.writeable} == {False}
        assert t.shape == y.shape[:1] == rate.shape[:1]
        sizes.append(len(t))
        return angle(t, y, rate)

    def one(t, y, rate):
        points.append(t)
        return angle(t, y, rate)

    problem = turning, (0, 3), np.eye(3)
    first, second = (
        cg.solve_ensemble(*problem, frame=SO3(), parameters=RATES, events=event).t_events[0]
        for event in (cg.Event(many, vectorized=True), one)
    )
    np.testing.assert_array_equal(np.concatenate(first), np.concatenate(second))
    assert sum(sizes) == len(points)
    assert len(sizes) < len(points) / 5
    sizes.clear()
    event = cg.Event(many, vectorized=True)
    cg.solve_ivp(*problem, frame=SO3(), parameters=RATES[0], events=event)
    assert set(sizes) == {1}


class TestErrors:
    def solve(self, function, solver=cg.solve_ensemble, **options):
        event = cg.Event(function, vectorized=True)
        y0 = UPS if solver is cg.solve_ensemble else UPS[0]
        events = [cg.Event(lambda t, y: y[..., 1], vectorized=True), event]
        return solver(lambda t, y: [y[1], -9.81], (0, 1), y0, frame=Euclidean(2), events=events)

    def test_shape(self):
        text = r"events\[1\] must return an array of shape \(40,\), a row for each member"
        refuses(ValueError, text, self.solve, lambda t, y: y)
        refuses(ValueError, "40 real numbers, a row.*got None", self.solve, lambda t, y: None)
        text = r"events\[1\] must return an array of shape \(1,\)"
        refuses(ValueError, text, self.solve, lambda t, y: 1.0, cg.solve_ivp)
        refuses(ValueError, text, self.solve, lambda t, y: y[:, :1], cg.solve_ivp)

    @pytest.mark.parametrize("solver", [cg.solve_ivp, cg.solve_ensemble])
    def test_numbers_that_are_not_finite(self, solver):
        text = r"events\[1\] must return finite numbers, got nan at t = 1"
        with pytest.warns(RuntimeWarning), pytest.raises(ValueError, match=text) as caught:
            self.solve(lambda t, y: np.log(y[:, 0]), solver)
        assert "events[1](t, y, ...)" in caught.value.__notes__[0]

    def test_exceptions(self):
        with pytest.raises(KeyError) as caught:
            self.solve(lambda t, y: {}["lost"])
        assert caught.value.__notes__ == ["in events[1](t, y, ...) at t = 0"]

    def test_flag(self):
        refuses(TypeError, "vectorized must be True or False", cg.Event, angle, vectorized=1)
        compiled = cg.CompiledFunction(ctypes.util.find_library("m"), "cos")
        refuses(ValueError, "vectorized must be False", cg.Event, compiled, vectorized=True)

"""Linear equations by Magnus methods with brackets: steps, defaults, estimates, output."""

import numpy as np
import pytest
from bracket_examples import WITH
from frame_examples import HEISENBERG, name
from refusals import refuses

import cg
from cg.frames import SO, SO3, SU, LinearAction, U, UnitQuaternion

METHOD = cg.methods["Magnus8(4)"]


def wave(frame, seed, size=2.0):
    """Return random coefficients with four frequencies."""
    rng = np.random.default_rng(seed)
    amplitudes = size * rng.normal(size=(4, frame.dim)) / np.sqrt(frame.dim)
    frequencies, phases = rng.uniform(0.5, 4, 4), rng.uniform(0, 6, 4)
    return lambda t: np.cos(frequencies * t + phases) @ amplitudes


@pytest.mark.parametrize("frame", [*WITH, SU(4), U(3), SO(6)], ids=name)
def test_steps_follow_the_exponent(frame):
    """Compiled brackets, and those in Python, against `Frame.bracket`."""
    a, h, y0 = wave(frame, 1, 0.3), 0.5, frame.random_point(np.random.default_rng(2))
    fields = [np.asarray(a(c * h)) for c in METHOD.c]
    for pair in METHOD.brackets:
        u, v = ([float(x.value) for x in row] @ np.array(fields) for row in pair)
        fields.append(h * frame.bracket(u, v))
    exponent = h * np.array([float(x.value) for x in METHOD.weights[0]]) @ np.array(fields)
    run = cg.solve_linear(a, (0, h), y0, frame=frame, method=METHOD, h=h)
    assert (run.nexp, run.steps) == (1, 1)
    np.testing.assert_allclose(run.y[-1], frame.flow(exponent, y0), rtol=0, atol=1e-14)


@pytest.mark.parametrize("frame", [SU(4), SU(8), SO(5), U(3), SU(16)], ids=repr)
def test_orders_and_errors_of_a_random_family(frame):
    """With the default: slopes of equal steps, and errors in tolerances."""
    slopes, quotients = [], []
    y0 = frame.random_point(np.random.default_rng(3))
    for seed in range(8):
        problem = wave(frame, seed), (0, 3), y0
        exact = cg.solve_linear(*problem, frame=frame, method="CFM8(4)", h=3 / 400).y[-1]
        runs = [cg.solve_linear(*problem, frame=frame, method=METHOD, h=3 / n) for n in (12, 24)]
        errors = [np.abs(run.y[-1] - exact).max() for run in runs]
        slopes.append(np.log2(errors[0] / errors[1]))
        for tolerance in (1e-4, 1e-7, 1e-10):
            run = cg.solve_linear(*problem, frame=frame, rtol=tolerance, atol=tolerance)
            quotients.append(np.abs(run.y[-1] - exact).max() / tolerance)
            assert run.nexp <= run.steps + run.nrejected + 1
    assert 7.5 < np.median(slopes) < 8.5
    assert np.median(quotients) < 0.3
    assert max(quotients) < 3


def test_the_estimate_sees_what_commutes_and_what_breaks():
    """Where all fields commute; jumps and kinks at random times."""
    z, frame = np.eye(15)[7], SU(4)
    options = {"frame": frame, "rtol": 1e-9, "atol": 1e-9}
    run = cg.solve_linear(lambda t: np.cos(20 * t) * z, (0, 2.3), np.eye(4), **options)
    exact = frame.flow(np.sin(46.0) / 20 * z, np.eye(4))
    assert np.abs(run.y[-1] - exact).max() < 1e-10
    for seed in range(12):
        a, place = wave(frame, seed), np.random.default_rng(seed).uniform(0.2, 1.8)

        def broken(t, a=a, place=place, kink=seed % 2):
            return a(t) * (1 + (t > place) * ((t - place) if kink else 1))

        problem = broken, (0, 2), np.eye(4)
        exact = cg.solve_linear(*problem, breakpoints=[place], **options | {"rtol": 1e-12}).y[-1]
        assert np.abs(cg.solve_linear(*problem, **options).y[-1] - exact).max() < 2e-9


def test_defaults():
    for frame, flows in [(SU(3), 1), (SO(4), 1), (UnitQuaternion(), 8), (HEISENBERG, 8)]:
        a = wave(frame, 0)
        y0 = frame.random_point(np.random.default_rng(1))
        assert cg.solve_linear(a, (0, 1), y0, frame=frame, h=0.25).nexp == 4 * flows
    matrices = [-1j * np.diag([1.0, -1.0]), -1j * np.array([[0, 1], [1, 0]])]
    run = cg.solve_linear(
        lambda t: [1.0, t], (0, 1), [1, 0], frame=LinearAction(matrices), method=METHOD, h=0.25
    )
    assert (run.nexp, run.nfev) == (4, 17)  # along polynomials, without brackets


def test_frames_without_brackets_are_refused():
    refuses(
        ValueError, r"method must be of Crouch-Grossman type or commutator-free on this frame, got "
        r"<MagnusMethod Magnus8\(4\).*which needs brackets", cg.solve_linear, lambda t: [1.0, t],
        (0, 1), np.zeros(3), frame=HEISENBERG, method=METHOD,
    )  # fmt: skip


class TestVectorized:
    @staticmethod
    def solve(a, vectorized, **options):
        return cg.solve_linear(
            a, (0, 1), np.eye(3), frame=SO3(), vectorized=vectorized, **({"h": 0.25} | options)
        )

    def test_all_nodes_of_a_step_are_in_one_call(self):
        calls = []

        def a(t):
            calls.append(t)
            return np.stack([t, 0 * t, t**2], axis=-1)

        run = self.solve(a, True, method="CFM8(4)")
        assert [len(t) for t in calls] == [1, 4, 4, 4, 4]
        assert run.nfev == 17
        np.testing.assert_allclose(calls[1], 0.25 * cg.methods["CFM8(4)"].c[1:], rtol=1e-15)

    @pytest.mark.parametrize("members", [3, 40])
    def test_calls_of_an_ensemble_are_few(self, members):
        """Each has all nodes of a step of all members, the first one the start."""
        calls = []

        def a(t, rows):
            calls.append(len(t))
            return np.stack([t * rows[:, 0], 0 * t, t**2], axis=-1)

        rows = np.linspace(0.5, 1.5, members)[:, None]
        options = {"frame": SO3(), "method": "CFM8(4)", "h": 0.25}
        run = cg.solve_linear_ensemble(
            a, (0, 1), np.eye(3), parameters=rows, vectorized=True, **options
        )
        assert sum(calls) == 17 * members
        assert len(calls) == 1 + 4
        for row, end in zip(rows, run.y[-1], strict=True):
            single = cg.solve_linear(
                lambda t, k=row[0]: [t * k, 0.0, t**2], (0, 1), np.eye(3), **options
            )
            np.testing.assert_array_equal(end, single.y[-1])

    def test_times_stay_before_a_breakpoint(self):
        calls = []

        def a(t):
            calls.append(t)
            return np.where(t < 0.5, 1.0, 3.0)[:, None] * [0.0, 0.0, 1.0]

        run = self.solve(a, True, method="CFM6(4)", h=0.5, breakpoints=[0.5])
        np.testing.assert_allclose(
            run.y[-1], SO3().flow([0, 0, 2.0], np.eye(3)), rtol=0, atol=5e-15
        )
        assert np.concatenate(calls[:2]).max() < 0.5

    def test_arguments_and_parameters(self):
        def a(t, rate, numbers):
            assert numbers.shape == (len(t), 2)
            return np.stack([rate * t, numbers[:, 0], numbers[:, 1]], axis=-1)

        together = self.solve(a, True, method="CFM6(4)", args=(2.0,), parameters=[0.5, 0.25])
        single = self.solve(lambda t: [2 * t, 0.5, 0.25], False, method="CFM6(4)")
        np.testing.assert_allclose(together.y, single.y, rtol=0, atol=1e-14)

    @pytest.mark.parametrize(("a", "message"), [
        (lambda t: np.ones(3), r"f must return an array of shape \(1, 3\), a row for each "
         r"time, since vectorized=True, got shape \(3,\)"),
        (lambda t: np.ones((3, len(t))), r"shape \(1, 3\), .* got shape \(3, 1\)"),
        (lambda t: np.ones((1, 3)), r"shape \(4, 3\), .* got shape \(1, 3\) at t = 0.069"),
    ])  # fmt: skip
    def test_wrong_results_are_refused(self, a, message):
        refuses(ValueError, message, self.solve, a, True, method="CFM6(4)")

    def test_what_is_not_finite_ends_it_as_without(self):
        a = lambda t: np.stack([np.where(t > 0, np.nan, 1)] * 3, axis=-1)
        runs = [self.solve(a, vectorized, method="CFM6(4)") for vectorized in (True, False)]
        assert "f must return finite numbers" in runs[0].message
        assert runs[0].message == runs[1].message

    def test_an_exception_ends_the_call(self):
        def a(t):
            if len(t) > 1:
                raise LookupError("no such field")
            return np.ones((len(t), 3))

        refuses(LookupError, "no such field", self.solve, a, True, method="CFM6(4)")

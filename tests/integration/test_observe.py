"""What is evaluated at output times, and progress."""

import ctypes
import pickle

import numpy as np
import pytest
from refusals import refuses

import cg
from cg.frames import SO3, Euclidean
from cg.integration.run import drive

pytestmark = pytest.mark.sanitize

TIMES = np.linspace(0, 3, 7)
SPIN = {"frame": SO3(), "rtol": 1e-6}
POINTS = SO3().random_point(np.random.default_rng(2), 3)
DOUBLE = ctypes.POINTER(ctypes.c_double)


def turn(t, y, *rest):
    rate = rest[-1][0] if rest else 1.0
    return [np.sin(t), rate * y[0, 0], 1.0]


def height(t, y, *rest):
    return t + y[2, 2]


def parts(t, y, *rest):
    return np.array([[t, *rest[-1]], [y[0, 1], y[1, 0]]]) if rest else [t, y[0, 1]]


def compiled(function):
    kind = ctypes.CFUNCTYPE(ctypes.c_double, ctypes.c_double, DOUBLE, ctypes.c_void_p)
    return kind(function)


def test_ensembles_without_parameters_and_members_that_end():
    last = cg.Event(lambda t, y: y[0] - 2, terminal=True)
    options = {"frame": Euclidean(1), "t_eval": [0.0, 0.5, 1.0], "events": last}
    run = cg.solve_ensemble(
        lambda t, y: y, (0, 1), [[0.5], [1.0]], observe=lambda t, y: y[0], **options
    )
    assert np.array_equal(run.observed, run.y[..., 0], equal_nan=True)
    assert np.isnan(run.observed[-1]).tolist() == [False, True]
    assert run[1].observed.shape == (2,)


def test_results_can_be_pickled():
    run = cg.solve_ivp(turn, (0, 3), np.eye(3), observe=parts, store="observed", **SPIN)
    assert np.array_equal(pickle.loads(pickle.dumps(run)).observed, run.observed)
    assert "steps" in repr(run)


class TestFailures:
    @pytest.mark.parametrize(("value", "match"), [
        (np.nan, "observe must return finite numbers, got nan at t = 1"),
        ([1.0, 2.0], r"observe must return one number, got shape \(2,\)"),
        ("text", "observe must return a real number, got 'text'"),
        (1j, "observe must return a real number"),
    ])  # fmt: skip
    @pytest.mark.parametrize("store", ["all", "observed"])
    def test_bad_values(self, value, match, store):
        options = {"observe": lambda t, y: value if t >= 1 else 0.0, "store": store}
        with pytest.raises(ValueError, match=match):
            cg.solve_ivp(turn, (0, 3), np.eye(3), t_eval=[0.0, 1.0, 2.0], **SPIN, **options)

    @pytest.mark.parametrize("start", [0.0, 1.0])
    def test_an_exception_ends_the_call(self, start):
        def fail(t, y):
            if t > start or len(called) > 0:
                raise KeyError("lost")
            called.append(t)
            return 1.0

        called = []
        with pytest.raises(KeyError, match="lost") as caught:
            cg.solve_ensemble(turn, (0, 3), POINTS, observe=fail, t_eval=TIMES, **SPIN)
        assert caught.value.__notes__[0].startswith("in observe(t, y, ...) at t = ")

    def test_a_compiled_one_that_is_not_finite(self):
        bad = compiled(lambda t, y, _: np.nan if t > 1 else 0.0)
        with pytest.raises(ValueError, match="observe must return finite numbers"):
            cg.solve_ivp(turn, (0, 3), np.eye(3), observe=bad, **SPIN)

    @pytest.mark.parametrize(("options", "error", "match"), [
        ({"observe": 3}, TypeError, r"observe must be callable as observe\(t, y\)"),
        ({"observe": [height]}, TypeError, "or a list of compiled functions"),
        ({"observe": lambda t, y: []}, ValueError, "observe must return at least one number"),
        ({"observe": lambda t, y: [1, [2]]}, ValueError, "observe must be an array of real"),
        ({"store": "observed"}, ValueError, "observe must be given with store='observed'"),
        ({"observe": height, "store": "some"}, ValueError, "store must be one of 'all', "),
    ])  # fmt: skip
    def test_bad_arguments(self, options, error, match):
        refuses(error, match, cg.solve_ivp, turn, (0, 3), np.eye(3), **SPIN, **options)


class Reports(list):
    def __call__(self, done, total):
        self.append((done, total))


@pytest.fixture
def reports(monkeypatch):
    monkeypatch.setattr(drive, "_REPORT_SECONDS", 0.0)
    return Reports()


def slowly(t, y):
    return [0.1, 0.2, np.cos(t)]


def check_reports(reports, total, end=None):
    done = [entry for entry, _ in reports]
    assert {entry for _, entry in reports} == {total}
    assert done == sorted(done)
    assert done[-1] == (total if end is None else pytest.approx(end, abs=1e-14))


class TestProgress:
    @pytest.mark.parametrize("options", [{}, {"h": 0.1}, {"t_eval": [1.0, 2.0]}])
    def test_of_solve_ivp(self, reports, options):
        cg.solve_ivp(
            slowly, (-1, 2), np.eye(3), frame=SO3(), progress=reports, method="DP5(4)", **options
        )
        check_reports(reports, 3.0)

    def test_of_integrations_that_end_early(self, reports):
        event = lambda t, y: t - 1.25
        event.terminal = True
        run = cg.solve_ivp(
            slowly, (0, 3), np.eye(3), frame=SO3(), events=event, max_step=0.5, progress=reports
        )
        assert run.status == 1
        assert reports[-1][0] < 3.0
        check_reports(reports, 3.0, reports[-1][0])

    def test_seldom_and_at_the_end(self):
        reports = Reports()
        cg.integrate(slowly, (0, 3), np.eye(3), frame=SO3(), method="CG3", h=0.01, progress=reports)
        assert reports[-1] == (3.0, 3.0)
        assert len(reports) < 100

    def test_its_errors_are_errors(self, reports):
        def stop(done, total):
            raise KeyboardInterrupt

        with pytest.raises(KeyboardInterrupt):
            cg.integrate(slowly, (0, 3), np.eye(3), frame=SO3(), method="CG3", h=0.1, progress=stop)


def test_large_finite_numbers_cause_no_warning():
    far = cg.Event(lambda t, y: np.full(len(t), 1e200), vectorized=True)
    solution = cg.solve_ensemble(
        lambda t, y: [0.0], (0, 1), [[0.0], [1.0]], frame=Euclidean(1), events=far,
        observe=lambda t, y: [1e308, 1e308],
    )  # fmt: skip
    assert (solution.observed == 1e308).all()

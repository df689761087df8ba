"""What is evaluated at output times, and stored with the points or instead of them."""

import ctypes
import pickle

import numpy as np
import pytest

import cg
from cg.frames import SO3, SU, Euclidean, LinearAction

TIMES = np.linspace(0, 3, 7)
SPIN = {"frame": SO3(), "rtol": 1e-6}
POINTS = SO3().random_point(np.random.default_rng(2), 3)
RATES = [[0.5], [1.0], [2.0]]
DOUBLE = ctypes.POINTER(ctypes.c_double)


def turn(t, y, *rest):
    rate = rest[-1][0] if rest else 1.0
    return [np.sin(t), rate * y[0, 0], 1.0]


def turn_all(t, y, rows):
    return np.stack([np.sin(t), rows[:, 0] * y[:, 0, 0], np.ones_like(t)], axis=-1)


def height(t, y, *rest):
    return t + y[2, 2]


def parts(t, y, *rest):
    return np.array([[t, *rest[-1]], [y[0, 1], y[1, 0]]]) if rest else [t, y[0, 1]]


def compiled(function):
    kind = ctypes.CFUNCTYPE(ctypes.c_double, ctypes.c_double, DOUBLE, ctypes.c_void_p)
    return kind(function)


def values(function, run, *rest):
    return np.array([function(t, y, *rest) for t, y in zip(run.t, run.y, strict=True)])


@pytest.mark.parametrize("observe", [height, parts])
@pytest.mark.parametrize(
    "options",
    [
        {},
        {"t_eval": TIMES},
        {"t_eval": TIMES[1:-1], "method": "RadauIIA5"},
        {"t_eval": TIMES, "breakpoints": [0.7, 1.0], "events": height},
        {"h": 0.2, "rtol": None, "dense_output": True},
        {"events": cg.Event(lambda t, y: t - 1.7, terminal=True), "t_eval": TIMES},
        {"events": cg.Event(lambda t, y: t - 1.7, jump=lambda t, y: y.T)},
        {"max_steps": 3},
    ],
    ids=["steps", "times", "radau", "breakpoints", "fixed", "terminal", "jump", "failure"],
)
@pytest.mark.parametrize("end", [3.0, -3.0])
def test_it_is_the_function_of_the_points(observe, options, end):
    sign = np.sign(end)
    options = {k: sign * np.array(v) if k in ("t_eval", "breakpoints") else v
               for k, v in options.items()}  # fmt: skip
    problem = (turn, (0, end), np.eye(3))
    run = cg.solve_ivp(*problem, observe=observe, **SPIN | options)
    assert np.array_equal(run.observed, values(observe, run))
    assert len(run.t) > 2
    assert not run.observed.flags.writeable
    alone = cg.solve_ivp(*problem, **SPIN | options)
    assert np.array_equal(alone.y, run.y)
    assert alone.nfev == run.nfev
    only = cg.solve_ivp(*problem, observe=observe, store="observed", **SPIN | options)
    assert only.y is None
    assert np.array_equal(only.t, run.t)
    assert np.array_equal(only.observed, run.observed)


def test_every_kth_step_and_compiled_functions():
    given = [compiled(lambda t, y, _: t + y[8]), compiled(lambda t, y, _: y[1])]
    options = {"frame": SO3(), "method": "CG3", "h": 0.1, "save_every": 4}
    run = cg.integrate(turn, (0, 3), np.eye(3), observe=given, **options)
    assert np.array_equal(run.observed[:, 0], values(height, run))
    assert np.array_equal(run.observed[:, 1], run.y[:, 0, 1])
    only = cg.integrate(turn, (0, 3), np.eye(3), observe=given[0], store="observed", **options)
    assert np.array_equal(only.observed, run.observed[:, 0])


@pytest.mark.parametrize("options", [
    {}, {"vectorized": True}, {"vectorized": True, "common_steps": True}, {"workers": 2}
], ids=str)  # fmt: skip
def test_ensembles(options):
    f = turn_all if "vectorized" in options else turn
    problem = (f, (0, 3), POINTS)
    options = {"t_eval": TIMES, "parameters": RATES, **SPIN, **options}
    run = cg.solve_ensemble(*problem, observe=parts, **options)
    assert run.observed.shape == (7, 3, 2, 2)
    for k, row in enumerate(RATES):
        assert np.array_equal(run.observed[:, k], values(parts, run[k], row))
        assert np.array_equal(run[k].observed, run.observed[:, k])
    only = cg.solve_ensemble(*problem, observe=parts, store="observed", **options)
    assert only.y is None is only[1].y
    assert np.array_equal(only.observed, run.observed)
    out = np.zeros((7, 3, 2, 2))
    only = cg.solve_ensemble(*problem, observe=parts, store="observed", out=out, **options)
    assert only.observed is out
    assert np.array_equal(out, run.observed)
    rate = compiled(lambda t, y, data: ctypes.cast(data, DOUBLE)[0])
    rates = cg.solve_ensemble(*problem, observe=rate, **options)
    assert np.array_equal(rates.observed[2], np.ravel(RATES))


def test_ensembles_without_parameters_and_members_that_end():
    last = cg.Event(lambda t, y: y[0] - 2, terminal=True)
    options = {"frame": Euclidean(1), "t_eval": [0.0, 0.5, 1.0], "events": last}
    run = cg.solve_ensemble(
        lambda t, y: y, (0, 1), [[0.5], [1.0]], observe=lambda t, y: y[0], **options
    )
    assert np.array_equal(run.observed, run.y[..., 0], equal_nan=True)
    assert np.isnan(run.observed[-1]).tolist() == [False, True]
    assert run[1].observed.shape == (2,)


def test_derivatives_and_linear_equations():
    run = cg.solve_variational(turn, (0, 3), np.eye(3), observe=height, t_eval=TIMES, **SPIN)
    assert np.array_equal(run.observed, values(height, run))
    with pytest.raises(ValueError, match='store must be "all" where solutions have derivatives'):
        cg.solve_variational(turn, (0, 3), np.eye(3), observe=height, store="observed", **SPIN)
    for frame, y0 in [(SU(2), np.eye(2)), (LinearAction([[[0, 1j], [1j, 0]]]), [1, 0])]:
        run = cg.solve_linear(
            lambda t, n: np.ones(n), (0, 3), y0, args=(frame.dim,), frame=frame,
            t_eval=np.linspace(0, 3, 99),
            observe=lambda t, y, n: abs(y.ravel()[0]) ** 2, store="observed", rtol=1e-9, atol=1e-9,
        )  # fmt: skip
        if frame.dim == 1:
            assert np.allclose(run.observed, np.cos(run.t) ** 2, atol=1e-8)
        assert (run.observed <= 1 + 1e-12).all()


def test_results_can_be_pickled_and_labelled():
    run = cg.solve_ivp(turn, (0, 3), np.eye(3), observe=parts, store="observed", **SPIN)
    assert np.array_equal(pickle.loads(pickle.dumps(run)).observed, run.observed)
    assert "steps" in repr(run)
    data = pytest.importorskip("xarray") and run.to_xarray()
    assert "y" not in data
    assert data["observed"].dims == ("t", "observable_0")


class TestFailures:
    @pytest.mark.parametrize(("value", "match"), [
        (np.nan, "observe must return finite numbers, got nan at t = 1"),
        ([1.0, 2.0], r"observe must return an array of shape \(\), got shape \(2,\)"),
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
        ({"store": "observed"}, ValueError, "observe must be given with store='observed'"),
        ({"observe": height, "store": "some"}, ValueError, "store must be 'all' or 'observed'"),
    ])  # fmt: skip
    def test_bad_arguments(self, options, error, match):
        with pytest.raises(error, match=match):
            cg.solve_ivp(turn, (0, 3), np.eye(3), **SPIN, **options)

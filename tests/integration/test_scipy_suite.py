"""SciPy's own tests of `solve_ivp`, run with this package's."""

import re
from functools import partial

import numpy as np
import pytest
from scipy.optimize import OptimizeResult

import cg

suite = pytest.importorskip("scipy.integrate._ivp.tests.test_ivp")

METHODS = {"RK23": "BS3(2)", "RK45": "DP5(4)", "DOP853": "DOP853"}
NAMES = ["t", "sol", "t_events", "y_events", "nfev", "njev", "nlu", "status", "message", "success"]
WORDS = {
    r"events\[0\].terminal must be a bool or a whole number": "The `terminal` attribute...",
    "args must be a tuple of further arguments": "Supplied 'args' cannot be unpacked.",
    "y0 must be finite": "All components of the initial state `y0` must be finite.",
    "A terminal event ended the integration.": "A termination event occurred.",
}
"""Messages, and SciPy's."""


def translated(text):
    """SciPy's words for one of our messages, or the message."""
    return next((theirs for ours, theirs in WORDS.items() if re.match(ours, text)), text)


def solve_ivp(fun, t_span, y0, method="RK45", vectorized=False, jac=None, **options):
    """Solve on Euclidean space; complex numbers are pairs of real ones, time is the last axis.

    Evaluations for output between steps aren't counted, and ``sol`` goes on after the end, as
    SciPy's does.
    """
    y0 = np.asarray(y0)
    y0 = y0 if y0.dtype.kind == "c" else y0.astype(float)
    name = METHODS.get(method if isinstance(method, str) else method.__name__, "RadauIIA5")
    options.pop("jac_sparsity", None)

    def f(t, y, *args):
        y = y.view(y0.dtype)
        value = fun(t, y[:, None], *args)[:, 0] if vectorized else fun(t, y, *args)
        return np.asarray(value, dtype=y0.dtype).view(float)

    if jac is not None and name == "RadauIIA5":
        options["jac"] = jac
    start = y0.view(float)
    solve = partial(cg.solve_ivp, f, frame=cg.frames.Euclidean(start.size), method=name, **options)
    try:
        solution = solve(t_span, start)
    except (TypeError, ValueError) as error:
        raise type(error)(translated(str(error))) from error
    result = OptimizeResult({name: getattr(solution, name) for name in NAMES})
    result.message = translated(result.message)
    result.y = solution.y.view(y0.dtype).T
    if not solution.t.size:
        result.t = result.y = []
    if method == "LSODA":  # which doesn't count them
        result.njev = result.nlu = 0
    if solution.y_events is not None:
        result.y_events = [y if len(y) else np.empty(0) for y in solution.y_events]
    if (sol := solution.sol) is not None:

        def at(t):
            if t <= sol.t_max or sol.t_min == sol.t_max:
                return sol(min(t, sol.t_max))
            return solve((sol.t_max, t), sol(sol.t_max), events=None, dense_output=False).y[-1]

        def evaluate(t):
            points = np.array([at(time) for time in np.ravel(t)])
            return points.view(y0.dtype).T.reshape(-1, *np.shape(t))

        result.sol = evaluate
        result.nfev = solve(t_span, start, dense_output=False, t_eval=None).nfev
    return result


@pytest.fixture(autouse=True)
def replaced(monkeypatch):
    monkeypatch.setattr(suite, "solve_ivp", solve_ivp)


@pytest.fixture
def num_parallel_threads():
    return 1


# Tests that fail, and why
DIFFERENCES = {
    "test_integration_complex": (
        AssertionError,
        "RadauIIA5 in place of BDF takes more evaluations",
    ),
    "test_empty": (ValueError, "a frame has at least one dimension"),
}
TESTS = {
    name: test
    for name, test in vars(suite).items()
    if name.startswith("test_") and "solve_ivp" in test.__code__.co_names
}
for name, test in TESTS.items():
    error, reason = DIFFERENCES.get(name, (None, ""))
    mark = pytest.mark.xfail(bool(reason), raises=error, reason=reason, strict=True)
    globals()[name] = mark(test)


def test_differences_are_of_tests_that_exist():
    assert set(DIFFERENCES) < set(TESTS)

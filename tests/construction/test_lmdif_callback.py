"""lmdif with bad arguments and with failing functions."""

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from numpy.testing import assert_array_equal
from refusals import refuses

import cg
from cg.support.shared_numbers import Status

START = [-1.2, 1.0]


def rosenbrock(x):
    return np.array([10 * (x[1] - x[0] ** 2), 1 - x[0]])


def at_call(number, then):
    """Return Rosenbrock's function, which returns `then` at the given call."""
    calls = 0

    def f(x):
        nonlocal calls
        calls += 1
        return then(x) if calls == number else rosenbrock(x)

    return f


# Calls 2 and 3 are differences, call 4 is the first step.
@pytest.mark.parametrize("call", [1, 2, 3, 4, 20])
@pytest.mark.parametrize(("returned", "error", "message"), [
    (None, TypeError, "f must return real numbers, got None"),
    ([1j, 2j], TypeError, "f must return real numbers"),
    (3.0, ValueError, r"f must return an array of shape \(m,\), got shape \(\)"),
    (np.ones((2, 1)), ValueError, r"f must return an array of shape .* got shape \(2, 1\)"),
    ([[1.0], [1.0, 2.0]], ValueError, "f must return an array"),
    ([1.0, np.nan], ValueError, r"f must return finite residuals, got f\[1\] = nan at x"),
    ([-np.inf, 1.0], ValueError, r"f must return finite residuals, got f\[0\] = -inf at x"),
])  # fmt: skip
def test_rejects_bad_residuals(call, returned, error, message):
    refuses(error, message, cg.lmdif, at_call(call, lambda x: returned), START)


@pytest.mark.parametrize("call", [2, 4])
@pytest.mark.parametrize("size", [1, 3])
def test_rejects_changing_number_of_residuals(call, size):
    with pytest.raises(ValueError, match=f"f must return 2 residuals as it did at x0, got {size}"):
        cg.lmdif(at_call(call, lambda x: np.ones(size)), START)


class Interrupted(BaseException):
    pass


def test_exception_passes_through_nested_calls():
    error = Interrupted()

    def inner(y):
        raise error

    outer = lambda x: cg.lmdif(inner, x).x
    with pytest.raises(Interrupted) as caught:
        cg.lmdif(at_call(4, outer), START)
    assert caught.value is error
    assert cg.lmdif(rosenbrock, START).nfev == 54


def test_calls_from_several_threads():
    solve = lambda start: cg.lmdif(rosenbrock, [start, 1.0])
    starts = np.linspace(-2, -1, 40)
    alone = [solve(start) for start in starts]
    with ThreadPoolExecutor(4) as pool:
        together = list(pool.map(solve, starts))
    assert [fit.nfev for fit in together] == [fit.nfev for fit in alone]
    for a, b in zip(alone, together, strict=True):
        assert_array_equal(a.x, b.x)


def test_f_may_modify_and_keep_its_argument():
    points = []

    def f(x):
        value = rosenbrock(x)
        x[:] = np.nan
        points.append(x)
        return value

    fit = cg.lmdif(f, START)
    assert_array_equal(fit.x, cg.lmdif(rosenbrock, START).x)
    assert np.isnan(points).all()


@pytest.mark.parametrize("kind", [list, tuple, lambda f: f.astype(np.longdouble)])
def test_f_may_return_other_sequences(kind):
    assert cg.lmdif(lambda x: kind(rosenbrock(x)), START).nfev == 54


def test_every_status_has_a_message():
    messages = {status.message for status in Status}
    assert len(messages) == len(Status)
    assert {status for status in Status if status.converged} == {1, 2, 3, 4}


def test_f_may_reuse_its_result():
    buffer = np.empty(2)

    def f(x):
        buffer[:] = rosenbrock(x)
        return buffer

    assert_array_equal(cg.lmdif(f, START).x, cg.lmdif(rosenbrock, START).x)


def test_x0_and_diag_are_unchanged():
    start, diag = np.array(START), np.array([1.0, 2.0])
    cg.lmdif(rosenbrock, start, diag=diag)
    assert_array_equal(start, START)
    assert_array_equal(diag, [1.0, 2.0])

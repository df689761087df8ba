"""lmdif with bad arguments and with failing functions."""

import numpy as np
import pytest
from refusals import refuses

import cg

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
@pytest.mark.parametrize(("returned", "message"), [
    (None, r"have shape .* got shape \(\)"),
    ([1j, 2j], "be an array of real numbers"),
    (3.0, r"have shape \(n,\) with n > 0, got shape \(\)"),
    (np.ones((2, 1)), r"have shape .* got shape \(2, 1\)"),
    ([[1.0], [1.0, 2.0]], "be an array"),
    ([1.0, np.nan], r"be finite, got nan at \[1\]"),
    ([-np.inf, 1.0], r"be finite, got -inf at \[0\]"),
])  # fmt: skip
def test_rejects_bad_residuals(call, returned, message):
    message = f"^f: the residuals must {message}"
    refuses(ValueError, message, cg.lmdif, at_call(call, lambda x: returned), START)


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

"""Adaptive steps with compiled functions equal those with functions in Python."""

import numpy as np
import pytest
from compiled_examples import PROBLEMS, both

import cg
from cg.frames import Euclidean
from cg.problems.affine import AffineField

TOLERANCE = 1e-13


def assert_same_steps(fast, slow, rounding=TOLERANCE):
    assert (fast.steps, fast.nrejected) == (slow.steps, slow.nrejected)
    np.testing.assert_allclose(fast.t, slow.t, rtol=rounding, atol=rounding)
    np.testing.assert_allclose(fast.y, slow.y, rtol=0, atol=10 * rounding)
    assert (fast.nfev, fast.nexp) == (slow.nfev, slow.nexp)
    assert (fast.status, fast.message, fast.success) == (slow.status, slow.message, slow.success)
    assert fast.method is slow.method


@pytest.mark.parametrize("name", list(PROBLEMS))
@pytest.mark.parametrize("control", [{"rtol": 1e-3}, {"rtol": 1e-6}, {"method": "CG4a", "h": 0.07}])
@pytest.mark.parametrize("span", [(0.2, 3.0), (1.0, -1.5)])
def test_steps_and_output_are_those_of_a_frame_in_python(name, control, span, affine):
    problem = PROBLEMS[name]
    f, _keep = affine(problem)
    options = {"method": "CG4(3)", **control}
    tolerance = options.get("rtol", 1.0)
    if "rtol" in options:
        options["atol"] = tolerance
    # error estimates are differences of points, whose last digits differ, as frames in Python
    # remove rounding off the manifold after all flows, and compiled code once a step
    rounding = max(TOLERANCE, 16 * np.finfo(float).eps / tolerance)
    times = np.linspace(*span, 37)
    problem_in_c = (f, span, problem.y0, problem.frame)
    fast, slow = both(*problem_in_c, **options)
    assert_same_steps(fast, slow, rounding)
    assert problem.frame.membership_error(fast.y).max() < 2e-15
    dense, other = both(*problem_in_c, dense_output=True, **options)
    assert_same_steps(dense, other, rounding)
    np.testing.assert_array_equal(dense.y, fast.y)
    np.testing.assert_array_equal(dense.sol(dense.t), dense.y)
    some, other = both(*problem_in_c, t_eval=times, dense_output=True, **options)
    np.testing.assert_array_equal(some.t, times)
    np.testing.assert_allclose(some.y, other.y, rtol=0, atol=10 * rounding)
    np.testing.assert_allclose(some.y, dense.sol(times), rtol=0, atol=1e-13)
    assert (some.steps, some.nfev, some.nexp) == (other.steps, other.nfev, other.nexp)
    assert problem.frame.membership_error(some.y).max() < 1e-14
    at_steps = both(*problem_in_c, t_eval=fast.t[[0, 2, -1]], **options)[0]
    np.testing.assert_array_equal(at_steps.y, fast.y[[0, 2, -1]])
    assert at_steps.nfev == fast.nfev


def test_motion_without_error(function):
    for y0, span in (([0.0], (0, 5)), ([0.0], (0, 1e-320)), ([0.0], (0, 1e6))):
        fast, slow = both(function("rests"), span, y0, Euclidean(1))
        assert_same_steps(fast, slow)
        assert fast.t[-1] == span[1]


def test_points_between_where_the_step_has_no_logarithm(affine):
    # A difference of the ends overflows, so that the method itself leads to the points between.
    problem = AffineField(Euclidean(1), [-1.2e308])
    problem.linear[:] = problem.slope[:] = 0.0
    problem.constant[:] = 1.2e308
    f, _keep = affine(problem)
    options = {"method": "CG4(3)", "first_step": 2.0, "t_eval": [0.5, 1.0, 1.5, 2.0]}
    solution = cg.solve_ivp(f, (0, 2), problem.y0, frame=problem.frame, **options)
    assert solution.steps == 1
    np.testing.assert_allclose(solution.y[:, 0] / 1e308, [-0.6, 0.0, 0.6, 1.2], rtol=0, atol=1e-14)

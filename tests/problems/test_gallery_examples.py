"""The example scripts of the gallery: invariants, the manifold, and exact solutions."""

import numpy as np
import pytest
from ambient import solve_in_ambient_space
from gallery import NAMES, example, load
from quotients import derivative

import cg


@pytest.mark.parametrize("name", NAMES)
def test_examples_keep_their_invariants_and_the_manifold(name):
    problem = example(name)
    solution = cg.solve_ivp(
        problem.f, (0, 2), problem.y0, frame=problem.frame, rtol=1e-10, atol=1e-10
    )
    assert np.max(problem.frame.membership_error(solution.y)) < 1e-14
    if hasattr(problem, "invariants"):
        start = problem.invariants(problem.y0)
        for key, values in problem.invariants(solution.y).items():
            np.testing.assert_allclose(values - start[key], 0.0, atol=1e-8, err_msg=key)


@pytest.mark.parametrize("name", ["toda", "two_levels"])
def test_exact_solutions_equal_those_in_the_ambient_space(name):
    problem = example(name)
    end = solve_in_ambient_space(problem.frame, problem.f, problem.y0, [1.0])[0]
    np.testing.assert_allclose(problem.exact(1.0), end, rtol=0, atol=1e-10)


def test_toda_keeps_the_spectrum_and_sorts_it():
    toda = load("toda")
    late = toda.exact(60.0)
    np.testing.assert_allclose(late, np.diag(toda.frame.spectrum[::-1]), rtol=0, atol=1e-12)
    np.testing.assert_allclose(toda.exact(0.0), toda.y0, rtol=0, atol=1e-14)
    np.testing.assert_allclose(np.triu(toda.exact(-2.0), 2), 0.0, rtol=0, atol=1e-12)


def test_two_level_system_matches_rabis_formula():
    system = load("two_levels")
    for t in (0.0, 0.5, 4.0):
        population = abs(system.exact(t)[1, 0]) ** 2
        assert population == pytest.approx(system.transition_probability(t), abs=1e-15)


class TestGradientFlow:
    def test_follows_the_gradient(self):
        flow = load("gradient_flow").GradientFlow((3, 2, 2))
        plaquettes = flow.frame.n * (3 - 1) / 2
        y = flow.y0
        slope = flow.f(0.0, y)

        def change(v):
            action = lambda s: plaquettes * flow.action(flow.frame.flow(s * v, y))
            return derivative(action, bound=1e-8)

        # The basis has squares of length one half.
        assert change(slope) == pytest.approx(-0.5 * slope @ slope, rel=1e-8)
        for k in range(0, len(slope), 31):
            assert change(np.eye(len(slope))[k]) == pytest.approx(-0.5 * slope[k], abs=1e-8)

"""The problems: equations against their ambient form, invariants, and references."""

import importlib.util
import sys
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from ambient import solve_in_ambient_space
from quotients import derivative
from refusals import refuses
from slow_cases import slow

import cg
from cg.problems import FreeRigidBody, HeavyTop, StateDependentRotation
from cg.problems.convergence import observed_order

GALLERY = Path(__file__).resolve().parents[2] / "docs/gallery"
NAMES = sorted(path.stem for path in GALLERY.glob("*.py") if not path.stem.startswith("plot_"))


def load(name):
    """Return an example script as a new module."""
    spec = importlib.util.spec_from_file_location(name, GALLERY / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module  # dataclasses look their module up
    spec.loader.exec_module(module)
    return module


def example(name):
    """Return what has the frame, y0, f and invariants of an example."""
    module = load(name)
    return module.GradientFlow() if name == "gradient_flow" else module


PROBLEMS = [
    FreeRigidBody(), HeavyTop(), HeavyTop("velocity"),
    StateDependentRotation("body"), *slow(StateDependentRotation("space")),
]  # fmt: skip


@pytest.mark.parametrize("problem", PROBLEMS, ids=repr)
def test_references_agree_with_an_independent_solver(problem):
    times = [0.5, 1.0]
    reference = problem.reference(times, bits=128)
    assert max(reference.errors) < 1e-30
    y = reference.y[:, : problem.y0.size].reshape(2, *problem.frame.point_shape)
    expected = solve_in_ambient_space(problem.frame, problem.f, problem.y0, times)
    np.testing.assert_allclose(y, expected, rtol=0, atol=1e-12)
    back = problem.reference([Fraction(-1, 2)], bits=128).y[0, : problem.y0.size]
    assert problem.frame.membership_error(back.reshape(problem.frame.point_shape)) < 1e-15
    if hasattr(problem, "invariants"):
        for key, values in problem.invariants(y).items():
            start = np.broadcast_to(problem.invariants(problem.y0)[key], values.shape)
            np.testing.assert_allclose(values, start, rtol=0, atol=4e-15)


@pytest.mark.parametrize(("make", "error", "message"), [
    (lambda: FreeRigidBody((1, 1, 3)), ValueError, "inertia must be positive, none larger"),
    (lambda: FreeRigidBody((1, 1, -1)), ValueError, "inertia must be positive"),
    (lambda: FreeRigidBody((1, 1)), ValueError, "inertia must be 3 finite numbers"),
    (lambda: FreeRigidBody(momentum=(0, 0, 0)), ValueError, "momentum must not vanish"),
    (lambda: FreeRigidBody(momentum=(0, 0, np.nan)), ValueError, "momentum must be 3 finite"),
    (lambda: HeavyTop("speed"), ValueError, "reading must be"),
    (lambda: HeavyTop("momentum", "third"), ValueError, "phi_over_pi must be rational"),
    (lambda: HeavyTop("momentum", np.nan), ValueError, "phi_over_pi must be rational"),
    *(
        (lambda t=t: HeavyTop().reference([t]), ValueError, "times must be finite numbers")
        for t in ("noon", np.nan, np.inf, None)
    ),
])  # fmt: skip
def test_bad_arguments_are_rejected(make, error, message):
    refuses(error, message, make)


def test_slope_of_exact_powers():
    h = np.array([0.05, 0.4, 0.1, 0.2])
    assert observed_order(h, 3.0 * h**4) == pytest.approx(4.0)


def test_errors_of_rounding_are_left_out():
    h, errors = np.array([0.5, 0.25, 0.125, 0.0625]), np.array([0.25, 0.0625, 0.015625, 1e-16])
    assert observed_order(h, errors, floor=1e-15) == pytest.approx(2.0)
    assert observed_order(h, errors) > 2.2


@pytest.mark.parametrize(("h", "errors", "changes", "message"), [
    ([0.1, 0.2], [1.0], {}, "must be vectors of one length"),
    ([[0.1, 0.2]], [[1.0, 2.0]], {}, "must be vectors of one length"),
    ([0.1, 0.2], [1.0, np.nan], {}, "errors must be finite and positive"),
    ([0.1, 0.2], [1.0, np.inf], {}, "errors must be finite and positive"),
    ([0.1, -0.2], [1.0, 2.0], {}, "h must be finite and positive"),
    ([0.1, 0.1], [1.0, 2.0], {}, "h must be distinct"),
    ([0.1, 0.2], [1e-17, 1.0], {"floor": 1e-15}, "errors must leave two points"),
])  # fmt: skip
def test_bad_errors_are_refused(h, errors, changes, message):
    refuses(ValueError, message, observed_order, h, errors, **changes)


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

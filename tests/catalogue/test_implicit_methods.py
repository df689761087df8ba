"""Implicit methods of the catalogue, and the statements of docs/implicit.md."""

from fractions import Fraction

import numpy as np
import pytest

import cg
from cg.construction.catalogue import methods
from cg.construction.methods.stability import stability_function, stability_limits
from cg.frames import SO3
from cg.problems import StateDependentRotation

SELF_ADJOINT = ["ImplicitMidpoint", "DICG4", "DICG4b", "DICG4c", "DICG6"]


def on_path(b, diagonal):
    return [[*b[:r], entry, *[0] * (len(b) - r - 1)] for r, entry in enumerate(diagonal)]


def step(equation, method, t, y, h):
    options = {"frame": equation.frame, "method": method, "h": abs(h)}
    return cg.integrate(equation.f, (t, t + h), y, **options).y[-1]


@pytest.fixture(scope="module", params=["body", "space"])
def problem(request):
    equation = StateDependentRotation(request.param)
    return equation, equation.reference([1], bits=128).y[0, :9].reshape(3, 3)


class TestCatalogue:
    def test_dicg3_is_l_stable_where_flows_commute(self):
        assert len({row[k] for k, row in enumerate(methods["DICG3"].exact[0])}) == 1
        above, below = stability_function(methods["DICG3"])
        assert abs(above[3] / below[3]) < 1e-14
        assert stability_limits(methods["DICG3"]).imaginary == np.inf


class TestSelfAdjoint:
    @pytest.mark.parametrize("name", SELF_ADJOINT)
    def test_a_step_back_undoes_a_step(self, problem, name):
        equation, _ = problem
        there = step(equation, methods[name], 0.2, equation.y0, 0.05)
        back = step(equation, methods[name], 0.25, there, -0.05)
        assert equation.frame.distance(there, equation.y0) > 0.01
        assert equation.frame.distance(back, equation.y0) < 1e-14

    @pytest.mark.parametrize("name", SELF_ADJOINT)
    def test_stages_are_on_the_path(self, name):
        a, b = methods[name].exact
        assert list(map(list, a)) == on_path(b, [a[r][r] for r in range(len(b))])
        offsets = [a[r][r] - entry / 2 for r, entry in enumerate(b)]
        near = Fraction(1, 10**35)
        assert all(abs(p - q) < near for p, q in zip(b, reversed(b), strict=True))
        assert all(abs(p + q) < near for p, q in zip(offsets, reversed(offsets), strict=True))


class TestDampedPair:
    def test_it_is_stiffly_accurate_with_one_diagonal_entry(self):
        a, b = methods["DICG3(2)"].exact
        assert a[-1] == b
        assert {a[i][i] for i in range(4)} == {Fraction(1, 4)}

    @pytest.mark.parametrize("damping", [1e2, 1e4, 1e6])
    @pytest.mark.parametrize("tolerance", [1e-3, 1e-5])
    def test_it_damps_within_the_tolerance(self, damping, tolerance):
        frame = cg.frames.Product(SO3(), cg.frames.Euclidean(3))

        def f(t, y):
            pull = damping * (y[9:] - np.cos(t))
            return np.concatenate([[0.3, 0.1 * np.sin(t), y[9]], -pull])

        problem = f, (0, 1), frame.join(np.eye(3), [2.0, 1.0, 0.0])
        exact, run = (
            cg.solve_ivp(*problem, frame=frame, method=method, rtol=tol, atol=tol)
            for method, tol in (("RadauIIA5", 1e-9), ("DICG3(2)", tolerance))
        )
        assert frame.distance(run.y[-1], exact.y[-1]) < tolerance
        # An explicit method takes more than damping / 5 of them.
        assert len(run.t) < 200

"""Coefficients of linear equations at many times in one call, and of many members."""

import numpy as np
import pytest
from refusals import refuses

import cg
from cg.frames import SO3


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
        """Those of few members have all nodes of a step, those of many a node of all members."""
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
        assert len(calls) == {3: 13, 40: 17}[members]
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
        (lambda t: np.stack([np.where(t > 0, np.nan, 1)] * 3, axis=-1),
         "f must return finite numbers"),
    ])  # fmt: skip
    def test_wrong_results_are_refused(self, a, message):
        refuses(ValueError, message, self.solve, a, True, method="CFM6(4)")

    def test_an_exception_ends_the_call(self):
        def a(t):
            if len(t) > 1:
                raise LookupError("no such field")
            return np.ones((len(t), 3))

        refuses(LookupError, "no such field", self.solve, a, True, method="CFM6(4)")

"""Layouts and solvers of weights, refinement in real(16), and polishing to short rationals."""

from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest
from coefficients import floats, values
from hypothesis import given, settings
from hypothesis import strategies as st
from quotients import jacobian
from strategies import point_trees

import cg
from cg import conditions
from cg.construction.catalogue import dumps, methods
from cg.construction.layouts import Layout, Rows
from cg.construction.search.candidate import Candidate, pack_method, to_method
from cg.construction.search.shapes import layout_of
from cg.construction.solvers.minimum_norm import fit_conditions
from cg.construction.solvers.refine import polish, refine
from cg.construction.solvers.system import ConditionSystem
from cg.support.quads import encode
from cg.support.shared_numbers import MinimumNormStatus


class TestLayout:
    @pytest.mark.parametrize("rows", Rows)
    @pytest.mark.parametrize("pair", [False, True])
    def test_rows_of_tableaux(self, rows, pair):
        layout = Layout.tableau(4, rows, pair)
        x = list(range(layout.size))
        assert layout.packed(layout.cut(x)) == x
        assert layout.packed(layout.full_rows(x)) == x
        assert layout.size == conditions.unknowns(4, rows) + 4 * pair
        assert layout.fixed == ([layout.size - 1] if pair else [])
        for stage in range(4):
            names = [layout.names[k] for k in layout.column(stage)]
            assert all(name.endswith((f",{stage + 1}", f"_{stage + 1}")) for name in names)
            assert not any(name.startswith(f"a_{stage + 1},") for name in names)
            smaller, columns = layout.without(stage)
            assert len(columns) == smaller.size

    def test_layout_round_trip(self):
        for name in ("CF4", "CF4b", "CG4(3)b", "CG4a"):
            method = methods[name]
            x = [coefficient.value for coefficient in method.coefficients]
            assert method.layout.tree(x) == method.tree


class TestSolvers:
    """Solvers for the weights of any layout."""

    @settings(deadline=None, max_examples=30)
    @given(point_trees(), st.data())
    def test_both_results_of_a_pair(self, tree, data):
        second = data.draw(st.integers(0, len(tree.points) - 1))
        tree = replace(tree, embedded_result=second)
        system = ConditionSystem(4, Layout.of_tree(tree))
        exact = [
            *conditions.residuals(tree, 4, independent=True, arithmetic="exact"),
            *conditions.residuals(tree, 3, independent=True, embedded=True, arithmetic="exact"),
        ]
        scale = 1 + max(map(abs, exact))
        actual = system.residual(floats(tree))
        np.testing.assert_allclose(actual, np.array(exact, float), rtol=0, atol=1e-13 * scale)
        actual = cg.support.quads.to_float(encode(exact))
        bits = system.residual_quad(encode(values(tree)), independent=True)
        np.testing.assert_allclose(bits, actual, rtol=0, atol=1e-14 * float(scale))
        slopes = system.jacobian(floats(tree))
        bound = 1e-7 * (1 + np.abs(slopes).max()) * float(scale)
        expected = jacobian(lambda s: system.residual(floats(tree) + s), system.size, bound)
        np.testing.assert_allclose(slopes, expected, rtol=0, atol=bound)


@pytest.mark.parametrize("name", ["CF6d", "CF6(5)"])
def test_weights_that_are_zero_up_to_rounding_become_zero(name):
    method = cg.methods[name]
    parents = tuple(point.parent for point in method.points)
    results = [m for m in (method.result, method.embedded_result) if m is not None]
    drawn = layout_of((parents, method.stage_points, *results))
    weights = [
        [float(point.weights.get(stage, 0)) for stage in stages]
        for point, stages in zip(method.points, drawn.weights, strict=True)
    ]
    x = np.concatenate(weights)
    absent = x == 0
    assert absent.any()
    x[absent] = 3e-18  # what a search leaves there
    again = to_method(
        Candidate(ConditionSystem(method.order, drawn), x), name=name, source="regenerated"
    )
    assert [set(p.weights) for p in again.points] == [set(p.weights) for p in method.points]
    assert "0.0000000000" not in dumps(again)


class TestRefine:
    @pytest.mark.parametrize("size", [1e-14, 1e-11, 1e-8, 1e-6])
    def test_refine_with_dependent_conditions(self, size):
        near = pack_method(methods["CG5a"]).x
        near += size * np.random.default_rng(1).standard_normal(near.size)
        fit = fit_conditions(near, ConditionSystem.tableau(5, 9))
        actual = refine(cg.support.quads.from_float(fit.x), ConditionSystem.tableau(5, 9))
        assert actual.max_residual < 2e-33
        moved = np.abs(cg.support.quads.to_float(actual.x) - near).max()
        assert moved < 1000 * size

    def test_evaluations_of_accurate_fits(self, monkeypatch):
        calls, residual = [], ConditionSystem.residual
        monkeypatch.setattr(
            ConditionSystem, "residual", lambda *args: calls.append(args) or residual(*args)
        )
        start = pack_method(methods["CG4a"]).x + 1e-3
        fit = fit_conditions(start, ConditionSystem.tableau(4, 5), accurate=True)
        assert fit.status == MinimumNormStatus.SOLVED
        assert fit.evaluations == len(calls)
        for ftol, x0, status in ((0.0, start, "NO_DESCENT"), (1e-9, np.nan * start, "NOT_FINITE")):
            fit = fit_conditions(x0, ConditionSystem.tableau(4, 5), accurate=True, ftol=ftol)
            assert fit.status == MinimumNormStatus[status]


class TestPolish:
    def test_polish_exceeds_binary128(self):
        near = list(map(Fraction, pack_method(methods["CG4a"]).x))
        fit = polish(near, ConditionSystem.tableau(4, 5))
        assert fit.max_residual < Fraction(1, 10**44)
        a, b = conditions.unpack(fit.x, 5)
        assert max(map(abs, conditions.residuals(a, b, 4, arithmetic="exact"))) < Fraction(
            1, 10**43
        )
        assert max(abs(p - q) for p, q in zip(fit.x, near, strict=True)) < 1e-14

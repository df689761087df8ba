"""Construction of methods along the solution set of the order conditions."""

from fractions import Fraction
from functools import partial

import numpy as np
import pytest

import cg
from cg.construction.conditions import Rows, residuals
from cg.construction.search.candidate import (
    Candidate,
    NotExactError,
    Reduction,
    pack_method,
    solved,
    to_method,
)
from cg.construction.search.construct import run_try
from cg.construction.search.optimise import optimise
from cg.construction.solvers.system import ConditionSystem, Structure

exactly = partial(residuals, arithmetic="exact")


def a_candidate(order, stages, seed=0):
    """Return the solution with the smallest coefficients of a few."""
    return pack_method(cg.search(order, stages, 10, seed).methods[0])


class TestMoving:
    def test_walk_reaches_another_solution(self):
        candidate = a_candidate(4, 6)
        moved = Reduction(np.random.default_rng(1)).walk(candidate, size=0.2)
        assert solved(moved)
        assert np.linalg.norm(moved.x - candidate.x) > 0.02

    def test_eliminate_stage(self):
        reduction = Reduction(np.random.default_rng(3))
        smallest = reduction.eliminate(a_candidate(4, 8, seed=1), "stages", 6)
        assert solved(smallest)
        method = to_method(smallest, name="six", source="test")
        assert (method.stages, method.order) == (6, 4)

    def test_drops_stage_without_influence(self):
        candidate = a_candidate(3, 3)
        a, b = np.zeros((4, 4)), np.zeros(4)
        keep = np.array([0, 2, 3])
        full_a, full_b = cg.conditions.unpack(candidate.x, 3)
        a[np.ix_(keep, keep)] = full_a
        a[1, 0], b[keep] = 0.7, full_b
        wider = Candidate(ConditionSystem.tableau(3, 4), cg.conditions.pack(a, b, Rows.EXPLICIT))
        smaller = Reduction(np.random.default_rng(0)).drop_stage(wider)
        np.testing.assert_allclose(smaller.x, candidate.x, rtol=0, atol=1e-12)


class TestOptimise:
    def test_optimise_reduces_principal_error(self):
        candidate = a_candidate(4, 6)
        better = optimise(candidate)
        assert solved(better)
        assert better.principal_error < 0.8 * candidate.principal_error
        method = to_method(better, name="better", source="test")
        assert method.order == 4
        assert method.principal_error == pytest.approx(better.principal_error, rel=1e-6)


class TestToTableau:
    @pytest.mark.parametrize(("order", "stages", "first"), [(3, 4, 4), (4, 6, 6), (4, 6, 8)])
    def test_pairs_are_constructed(self, order, stages, first):
        pair = cg.construct(order, stages, 1, embedded=True, first_stages=first).method
        assert (pair.order, pair.embedded_order, pair.stages) == (order, order - 1, stages)

    def test_inexact_candidate_is_no_method(self):
        far = Candidate(ConditionSystem.tableau(4, 5), np.random.default_rng(0).uniform(-1, 1, 15))
        with pytest.raises(NotExactError, match=r"largest residual .* after refinement"):
            to_method(far, name="no", source="test")


class TestConstruct:
    def test_order_four_from_more_stages(self):
        construction = cg.construct(order=4, stages=5, seed=2, first_stages=6)
        assert construction.method
        assert (construction.method.order, construction.method.stages) == (4, 5)
        assert max(map(abs, exactly(*construction.method.exact, 4))) < Fraction(1, 10**33)

    @pytest.mark.parametrize("stages", [15, pytest.param(12, marks=pytest.mark.slow)])
    def test_order_six(self, stages):
        construction = cg.construct(order=6, stages=stages, seed=1, tries=40)
        assert construction.method
        assert construction.settings.structure is Structure.MIDDLE
        assert (construction.method.order, construction.method.stages) == (6, stages)
        assert max(map(abs, exactly(*construction.method.exact, 6))) < Fraction(1, 10**33)
        c, b = construction.method.c, construction.method.b
        np.testing.assert_allclose(c[2:], np.cumsum(b)[2:] - b[2:] / 2, rtol=0, atol=1e-15)

    def test_rejects_too_few_stages_for_structure(self):
        with pytest.raises(ValueError, match=r"64 unknowns for 72 .* with structure MIDDLE"):
            cg.construct(order=6, stages=11, seed=0, structure=Structure.MIDDLE)

    def test_no_method_if_all_tries_fail(self):
        construction = cg.construct(order=4, stages=4, seed=0, tries=3, first_stages=6, force=True)
        assert construction.method is None
        assert not construction.method
        assert construction.tries == 3
        assert construction.best.layout.stages >= 4
        assert "seed 0: no method in 3 tries, the smallest" in repr(construction)


@pytest.mark.parametrize(("scale", "useful"), [(1.0, True), (0.5, True), (1e-7, False)])
def test_pairs_with_a_useless_estimate_are_no_solutions(scale, useful):
    """The conditions are homogeneous in the weights of the estimate, the last flow."""
    settings = cg.construct(3, 4, flows=4, embedded=True, seed=1, tries=1, workers=1).settings
    attempt = run_try(settings, 0)
    assert attempt.solved
    x = np.array(attempt.x)
    x[attempt.layout.starts[-2] :] *= scale
    candidate = Candidate(ConditionSystem(3, attempt.layout), x)
    assert solved(candidate)
    reduction = Reduction(np.random.default_rng(0), settings.max_coefficient)
    assert reduction.accepts(candidate) is useful


def test_dropped_flows_leave_no_idle_stage():
    points = [(-1, {0: "1/3"}), (-1, {1: "2/3"}), (0, {0: "-1/12", 2: "3/4"}), (2, {3: 1})]
    method = cg.CommutatorFree(points, [-1, 0, 1, 2], 2)  # CF3, and a fourth stage at a leaf
    candidate = pack_method(method)
    assert set(method.layout.stage_of.tolist()) == set(range(method.stages))
    assert Reduction(np.random.default_rng(0)).drop_flow(candidate) is None


def test_construct_starts_at_the_highest_order():
    construction = cg.construct(8, 20, seed=0, tries=1, iterations=1, first_stages=20, force=True)
    assert not construction.method
    assert construction.tries == 1

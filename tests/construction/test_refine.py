"""Refinement in real(16), and polishing to short rationals."""

from fractions import Fraction

import numpy as np
import pytest

from cg import conditions
from cg.construction.catalogue import methods
from cg.construction.conditions import residuals, unpack
from cg.construction.solvers.minimum_norm import fit_conditions
from cg.construction.solvers.refine import polish, refine
from cg.construction.solvers.system import ConditionSystem
from cg.support import quads


def packed(name):
    a, b = methods[name].exact
    return [
        entry for row, length in zip(a, range(len(b)), strict=True) for entry in row[:length]
    ] + [*b]


class TestRefine:
    @pytest.mark.parametrize("size", [1e-14, 1e-11, 1e-8, 1e-6])
    def test_refine_with_dependent_conditions(self, size):
        near = np.array(packed("CG5a"), float)
        near += size * np.random.default_rng(1).standard_normal(near.size)
        fit = fit_conditions(near, ConditionSystem.tableau(5, 9))
        actual = refine(quads.from_float(fit.x), ConditionSystem.tableau(5, 9))
        assert actual.rank == 37 < conditions.count(5, independent=True)
        assert actual.largest_residual < 2e-33
        moved = np.abs(quads.to_float(actual.x) - near).max()
        assert moved < 1000 * size


class TestPolish:
    def test_polish_exceeds_binary128(self):
        near = [Fraction(float(entry)) for entry in packed("CG4a")]
        fit = polish(near, ConditionSystem.tableau(4, 5))
        assert fit.largest_residual < Fraction(1, 10**44)
        a, b = unpack(fit.x, 5)
        assert max(map(abs, residuals(a, b, 4, arithmetic="exact"))) < Fraction(1, 10**43)
        assert fit.iterations <= 5
        assert max(abs(p - q) for p, q in zip(fit.x, near, strict=True)) < 1e-14

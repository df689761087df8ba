"""Residuals of any words in rational arithmetic."""

from cg.construction.conditions.exact import Condition, EquationSystem
from cg.support.quads import to_flint, to_fraction


def word_residuals(layout, x, words):
    system = EquationSystem(layout, tuple(Condition(0, word) for word in words))
    return list(map(to_fraction, system.residuals(list(map(to_flint, x)))))

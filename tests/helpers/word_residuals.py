"""Residuals of any words in rational arithmetic."""

from cg.construction.conditions.word_weights import EquationSystem
from cg.construction.conditions.words import Condition
from cg.support.balls import to_flint, to_fraction


def word_residuals(layout, x, words):
    system = EquationSystem(layout, tuple(Condition(0, word) for word in words))
    return list(map(to_fraction, system.residuals(list(map(to_flint, x)))))

"""Matrices of flint and of doubles, and residuals of any words in rational arithmetic."""

import numpy as np
from flint import acb_mat, arb_mat

from cg.construction.conditions.exact import Condition, EquationSystem
from cg.support.quads import to_flint, to_fraction


def flint_matrix(x):
    return (acb_mat if x.dtype.kind == "c" else arb_mat)(x.tolist())


def doubles(matrix):
    convert = complex if isinstance(matrix, acb_mat) else float
    return np.array([[convert(x) for x in row] for row in matrix.tolist()])


def word_residuals(layout, x, words):
    system = EquationSystem(layout, tuple(Condition(0, word) for word in words))
    return list(map(to_fraction, system.residuals(list(map(to_flint, x)))))

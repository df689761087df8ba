"""Matrices of flint and of doubles, and residuals of any words in rational arithmetic."""

from itertools import chain, product
from math import factorial

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


def splitting_residuals(drifts, kicks, order):
    """Return the coefficients of words of T (0) and V (1) in a step, less those of exp(T + V)."""
    step = {(): 1}
    numbers = [*chain.from_iterable(zip(drifts, kicks, strict=False)), drifts[-1]]
    for k, number in enumerate(numbers):
        longer = {}
        for word, x in step.items():
            for n in range(order + 1 - len(word)):
                key = (k % 2,) * n + word
                longer[key] = longer.get(key, 0) + x * number**n / factorial(n)
        step = longer
    words = chain.from_iterable(product((0, 1), repeat=n) for n in range(1, order + 1))
    return {word: step.get(word, 0) - 1 / (numbers[0] * 0 + factorial(len(word))) for word in words}

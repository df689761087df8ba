"""Matrices of flint, in as many digits as its context has, and of doubles."""

import numpy as np
from flint import acb_mat, arb_mat


def flint_matrix(x):
    return (acb_mat if x.dtype.kind == "c" else arb_mat)(x.tolist())


def doubles(matrix):
    convert = complex if isinstance(matrix, acb_mat) else float
    return np.array([[convert(x) for x in row] for row in matrix.tolist()])

"""Error estimates of commutator-free pairs."""

from math import factorial

import numpy as np
import pytest

import cg

PAIRS = [
    name
    for name, m in cg.methods.items()
    if isinstance(m, cg.CommutatorFree) and m.embedded_order is not None
]


@pytest.mark.parametrize("name", PAIRS)
def test_estimates_do_not_vanish_on_quadratures_and_linear_problems(name):
    pair = cg.methods[name]
    p, second = pair.order, pair.embedded
    assert second.order == pair.embedded_order
    # DOP853's estimate is of order five, whatever its name says
    assert second.order == (5 if name == "DOP853" else p - 1)
    p = second.order + 1
    a, b = (np.array(rows, dtype=float) for rows in second.exact)
    c = a.sum(axis=1)
    quadrature = abs(b @ c ** (p - 1) - 1 / p)
    linear = abs(b @ np.linalg.matrix_power(a, p - 1) @ np.ones(len(b)) - 1 / factorial(p))
    # Verner's are as they are: 1/16200, and 4.4e-6; 8.1e-6 and 2.5e-6 of order eight.
    assert quadrature > {"DVERK6(5)": 6e-5, "Verner8(7)": 8e-6}.get(name, 1e-4)
    assert linear > {"Verner7(6)": 4e-6, "Verner8(7)": 2.5e-6}.get(name, 1e-5)

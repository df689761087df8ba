"""Error estimates of commutator-free pairs."""

from math import factorial

import numpy as np
import pytest

import cg
from cg.frames import Euclidean
from cg.problems import HeavyTop

PAIRS = [
    name
    for name, m in cg.methods.items()
    if isinstance(m, cg.CommutatorFree) and m.embedded_order is not None
]


def test_catalogue_has_free_pairs():
    assert {"CF4(3)", "CF5(4)"} <= set(PAIRS)


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


@pytest.mark.parametrize("name", PAIRS)
@pytest.mark.parametrize("f", [lambda t, y: [np.cos(3 * t)], lambda t, y: [-y[0]]])
def test_steps_follow_the_estimate(name, f):
    """With a vanishing estimate one step would cover the whole interval."""
    run = cg.solve_ivp(f, (0, 3), [1.0], frame=Euclidean(1), method=name, rtol=1e-8, atol=1e-8)
    exact = 1 + np.sin(9) / 3 if f(0.0, [0.0]) == [1.0] else np.exp(-3)
    assert len(run.t) > 8
    assert abs(run.y[-1, 0] - exact) < 1e-6


@pytest.mark.parametrize("name", PAIRS)
@pytest.mark.parametrize("rtol", [1e-5, 1e-7, 1e-9])
def test_error_is_of_the_order_of_the_tolerance(name, rtol):
    top = HeavyTop()
    options = {"frame": top.frame, "rtol": rtol, "atol": rtol}
    run = cg.solve_ivp(top.f, (0, 2), top.y0, method=name, **options)
    options |= {"rtol": 1e-12, "atol": 1e-12}
    fine = cg.solve_ivp(top.f, (0, 2), top.y0, method="CG6(5)", **options)
    error = top.frame.distance(run.y[-1], fine.y[-1])
    assert 1e-3 * rtol < error < 100 * rtol

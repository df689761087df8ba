"""Prescribed coefficients and abscissae in searches and constructions."""

from fractions import Fraction

import numpy as np
import pytest
from refusals import refuses

import crouch_grossman as cg
from cg.construction.layouts.layout import Layout
from cg.construction.solvers.held import read_hold

SHAPES = {
    "explicit": ({"order": 3, "stages": 4, "starts": 20}, Layout.tableau(4)),
    "diagonal": (
        {"order": 3, "stages": 3, "rows": "diagonal", "starts": 20},
        Layout.tableau(3, "diagonal"),
    ),
    "tree": (
        {"order": 3, "stages": 4, "tree": cg.methods["CF4"], "starts": 40},
        cg.methods["CF4"].layout,
    ),
}


def random_hold(layout, random):
    """Return a coefficient and an abscissa with random values."""
    name = layout.names[random.integers(layout.size)].replace("_", "[", 1) + "]"
    stage = int(random.integers(2, layout.stages + 1))
    value, c = (f"{random.integers(1, 7)}/{random.integers(3, 9)}" for _ in range(2))
    return {name: value} | ({f"c[{stage}]": c} if len(layout.row(stage - 1)) > 1 else {})


def assert_held(method, hold, exactly=True):
    x, layout = [entry.value for entry in method.coefficients], method.layout
    rows = {name: [k] for k, name in enumerate(layout.names)}
    rows |= {f"c_{r + 1}": layout.row(r) for r in range(layout.stages)}
    for name, value in read_hold(hold):
        off = abs(sum(x[k] for k in rows[name]) - Fraction(value))
        assert off == 0 if name[0] != "c" and exactly else off < Fraction(1, 10**33), name


@pytest.mark.parametrize("shape", SHAPES)
def test_methods_keep_held_values(shape):
    arguments, layout = SHAPES[shape]
    random, solved = np.random.default_rng(7), 0
    for _ in range(6):
        hold = random_hold(layout, random)
        for method in cg.search(**arguments, seed=3, hold=hold).methods[:3]:
            assert method.exact_order >= 3
            assert_held(method, hold)
            solved += 1
    assert solved >= 6


def test_construct_keeps_held_values_and_the_interval_of_abscissae():
    hold = {"c[3]": "1/2", "b[2]": 0, "a[2,1]": "1/3"}
    assert_held(cg.construct(4, 6, seed=1, hold=hold).method, hold)
    assert_held(
        cg.construct(5, 10, 1, hold=hold, structure=cg.Structure.STAGE_ORDER_TWO).method, hold
    )
    for shape in ({}, {"flows": 6}):
        method = cg.construct(4, 5, seed=1, abscissae=(0, 0.95), **shape).method
        assert method.c.min() >= 0
        assert method.c.max() <= 0.95
        best = cg.construct(4, 5, seed=1, minimise="principal_error", **shape).method
        assert best.principal_error < 0.9 * method.principal_error


@pytest.mark.parametrize(("hold", "message"), [
    (3, "mapping"),
    ({1: 2}, "mapping"),
    ({"a[1,2]": 1}, "there is no a_1,2"),
    ({"b[1]": "x"}, "b\\[1\\]: expected a finite real number"),
    ({"b[1]": 1, "b_1": 2}, "two values"),
    ({"c[1]": 1}, "c_1 = 1 contradicts"),
    ({"c[3]": 1, "a[3,1]": 1, "a[3,2]": 1}, "contradicts"),
    ({f"b[{k}]": "1/2" for k in range(1, 6)}, "no method of order 4: the condition of tree"),
    ({"a[2,1]": 1, "a[3,1]": 1, "a[4,1]": 1}, "12 unknowns for 13 conditions"),
])  # fmt: skip
def test_impossible_values_are_refused(hold, message):
    refuses((TypeError, ValueError), f"hold.*{message}", cg.search, 4, 5, hold=hold)

"""Methods that were moved along the solution set together with their tableaux."""

import importlib
import sys
from pathlib import Path

import numpy as np
import pytest

import cg
from cg.construction import Goals, pack_method, solved


@pytest.fixture
def tool(monkeypatch):
    monkeypatch.syspath_prepend(str(Path(__file__).parents[2] / "research"))
    yield importlib.import_module("make_walked_methods")
    sys.modules.pop("make_walked_methods", None)


def test_wider_flows_are_the_same_method(tool):
    lifted = pack_method(cg.methods["DP5(4)"])
    wide = tool.widened(lifted)
    assert wide.system.size > lifted.system.size
    assert wide.principal_error == pytest.approx(lifted.principal_error, rel=1e-12)
    cleaned = tool.cleaned(wide)
    assert cleaned.system == lifted.system
    np.testing.assert_allclose(cleaned.x, lifted.x, rtol=0, atol=1e-13)


def test_a_walk_leads_down_and_moves_the_tableau(tool):
    candidate = tool.walked(tool.Walk("x", "DP5(4)", Goals(bound=2.0, bound_weight=1e-4), 5))
    before = pack_method(cg.methods["DP5(4)"])
    assert solved(candidate)
    assert candidate.principal_error < 0.9 * before.principal_error
    assert candidate.largest < before.largest / 2
    layout = candidate.system.layout
    ends = [candidate.x[layout.row(k)].sum() for k in range(layout.stages)]
    assert np.abs(np.array(ends) - cg.methods["DP5(4)"].c).max() > 1e-3


@pytest.mark.parametrize(
    ("name", "error", "weight"),
    [("CF7(6)", 3, 8), pytest.param("CF8a", 2, 1.1, marks=pytest.mark.slow)],
)
def test_they_are_better_than_what_they_came_from(tool, name, error, weight):
    (walk,) = (walk for walk in tool.WALKS if walk.name == name)
    better, start = cg.methods[name], cg.methods[walk.start]
    assert (better.order, better.embedded_order) == (start.order, start.embedded_order)
    assert (better.stages, better.exponentials) == (start.stages, start.exponentials)
    assert better.principal_error < start.principal_error / error
    largest = [max(abs(float(e.value)) for e in m.coefficients) for m in (better, start)]
    assert largest[0] < largest[1] / weight

"""Searches, constructions, lifts and lmdif refuse bad arguments by name, before they compute."""

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from refusals import refuses

import cg
from cg.construction.conditions import MAX_ORDER

NAN, HUGE = float("nan"), 10**30
CHAIN = (tuple(range(-1, 8)), (-1, 0, 1, 3, 4, 7))  # six stages
CLASSICAL = cg.methods["RKMK4"].tableau


def never(x):
    raise AssertionError("f was called")


BOTH = {
    "order": [0, 99], "stages": [0, HUGE], "seed": [-1], "workers": [0], "progress": ["yes"],
    "executor": ["fast", 3, ThreadPoolExecutor], "tree": ["x", ((-1,),), (3, (-1,))],
    "flows": [5, True], "embedded": [1], "first_same_as_last": [True],
}  # fmt: skip
SEARCH = {
    "starts": [0, HUGE], "maxfev": [0, HUGE], "refine_maxfev": [0, HUGE], "algorithm": ["newton"],
    "rows": ["lower"], "width": [-0.5, NAN, 1e308], "refine_below": [-1],
    "abscissae": [(1, 0), 1.0, (0, np.inf), "01"], "minimise": ["flows"],
    "bound": [0, {"x": (0, 1)}, {"b": (1, 0)}, {"b": 1}, {3: (0, 1)}, {"c": ("0", 1)}],
    "nonnegative": [3, "", [2]],
}  # fmt: skip
CONSTRUCT = {"tries": [0, HUGE], "iterations": [HUGE], "largest": [0], "first_stages": [2]}
LIFT = {
    "tableau": [cg.methods["CF3"], cg.methods["ImplicitMidpoint"]], "order": [0, 5],
    "embedded_order": [3], "chains": [[1, 1], [1, 1, 0, 1]], "flows": [3], "tries": [0],
    "hits": [0], "seed": [-1], "reduce": ["no"], "max_iterations": [0],
}  # fmt: skip
LMDIF = {
    "f": [3], "x0": [[[1.0, 2.0]], 1.0, [1.0, NAN], ["a", "b"], [[1.0], [1.0, 2.0]]],
    "ftol": [-1e-8], "xtol": [-1e-8], "gtol": [-1e-8, "small"], "epsfcn": [-1e-8], "factor": [0.0],
    "maxfev": [0, 2**31, 10.0], "diag": [[1.0], [1.0, 0.0]],
}  # fmt: skip
SHAPES = [
    {"tree": CHAIN, "first_same_as_last": True}, {"tree": CHAIN, "stages": 7},
    {"tree": CHAIN, "embedded": True}, {"flows": 9, "first_same_as_last": 2},
    {"flows": 9, "embedded": 1},
]  # fmt: skip


def cases(function, good, table, *others):
    """Return calls, each with one argument or some of them changed, of which the last is bad."""
    changes = [{name: value} for name, values in table.items() for value in values]
    return [(function, good | change, [*change][-1]) for change in [*changes, *others]]


GOOD = {"order": 5, "stages": 6, "seed": 1, "force": True}


@pytest.mark.parametrize(("function", "arguments", "name"), [
    *cases(cg.search, GOOD | {"starts": 1}, BOTH | SEARCH, *SHAPES),
    *cases(cg.search, GOOD | {"starts": 1}, {}, {"minimise": "principal_error"}
           | {"order": MAX_ORDER}),
    *cases(cg.search, GOOD | {"starts": 1}, {}, {"embedded": True, "algorithm": "lmdif"},
           {"flows": 9, "bound": {"b": (0, 1)}},
           {"force": False, "stages": 9, "nonnegative": "b"},
           {"force": False, "stages": 9, "bound": {"b": (0, None)}, "nonnegative": ()}),
    *cases(cg.construct, GOOD, BOTH | CONSTRUCT, *SHAPES),
    *cases(cg.lift, {"tableau": CLASSICAL}, LIFT, {"chains": [1, 1, 1, 2], "flows": 5}),
    *cases(cg.lmdif, {"f": never, "x0": [-1.2, 1.0]}, LMDIF),
    *cases(cg.lmdif, {}, {}, {"x0": [1.0, 1.0, 1.0], "f": lambda x: x[:2]},
           {"x0": [1.0, 1.0], "f": lambda x: np.where(x > 1, 1e308, -1e307)}),
])  # fmt: skip
def test_bad_arguments_are_named(function, arguments, name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    stored = {"store": "runs.jsonl"} if "force" in arguments else {}
    refuses((TypeError, ValueError), rf"\b{name}\b", function, **arguments, **stored)
    assert not list(tmp_path.iterdir())

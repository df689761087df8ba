"""Reference steps: computed by the tool and by the core, and close to the solution."""

import json
from pathlib import Path

import numpy as np
import pytest
from kinds import FROZEN, MUNTHE_KAAS

import cg
from cg.problems import StateDependentRotation

TOOL = "tools/make_reference_steps"
FILE = Path(cg.construction.catalogue.__file__).parent / "reference_steps.json"
REFERENCE = json.loads(FILE.read_text(encoding="utf-8"))
METHODS = {**FROZEN, **MUNTHE_KAAS}
H = 0.25


def as_rotation(texts):
    return np.array([float(text) for text in texts]).reshape(3, 3)


def step_of(method):
    problem = StateDependentRotation()
    run = cg.integrate(problem.f, (0.0, H), problem.y0, frame=problem.frame, method=method, h=H)
    return run.y[-1]


def test_every_method_has_a_reference_step():
    """If this fails, `make catalogue` hasn't been run since a method was added."""
    assert set(REFERENCE["steps"]) == set(METHODS)
    pairs = {name for name, method in METHODS.items() if method.embedded is not None}
    assert {name for name, entry in REFERENCE["steps"].items() if "embedded" in entry} == pairs


def test_problem_equals_that_of_the_package():
    problem = REFERENCE["problem"]
    own = StateDependentRotation()
    for name in ("constant", "slope", "linear"):
        stored = np.array(problem[name]) / problem["unit"]
        np.testing.assert_array_equal(stored, getattr(own, name))
    assert problem["h"] == "1/4"


@pytest.mark.parametrize(
    "name", ["LieEuler", "CG3", "CG4a", "CG4(3)", "CF5a", "CF5(4)", "DICG3", "RKMK4", "DOP853"]
)
def test_tool_reproduces_the_steps(tool, name):
    assert tool.entry_of(METHODS[name]) == REFERENCE["steps"][name]


@pytest.mark.parametrize("name", METHODS)
def test_core_agrees_with_reference_steps(name):
    method, entry = METHODS[name], REFERENCE["steps"][name]
    # a few roundings a flow, and what they grow by
    largest = max(abs(float(weight.value)) for weight in method.coefficients)
    tolerance = 1e-15 * (4 + method.exponentials / 4) * max(1.0, largest)
    assert abs(step_of(method) - as_rotation(entry["result"])).max() < tolerance
    if method.embedded is not None:
        second = step_of(method.embedded)
        assert abs(second - as_rotation(entry["embedded"])).max() < tolerance
        assert abs(second - as_rotation(entry["result"])).max() > 100 * tolerance

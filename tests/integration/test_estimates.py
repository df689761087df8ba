"""Ratios of errors to error estimates, for default methods and lifted pairs."""

import sys
from pathlib import Path

import numpy as np
import pytest
from frame_examples import HEISENBERG

import cg
from cg.frames import SO3, Stiefel
from cg.integration.default_method import choose_method

ROOT = Path(__file__).parents[2]
TOLERANCES = (1e-3, 1e-5, 1e-8)
FRAMES = (SO3(), Stiefel(3, 2), HEISENBERG)
DEFAULTS = sorted({choose_method(frame, rtol) for frame in FRAMES for rtol in (None, *TOLERANCES)})


@pytest.fixture(scope="module")
def equations():
    """A small part of the benchmark's set."""
    sys.path.insert(0, str(ROOT))
    from benchmarks.cases import cases
    from benchmarks.estimates import spins

    yield spins(6) + cases(["heavy_top", "wheels", "toda"])
    sys.path.remove(str(ROOT))


@pytest.fixture
def tool(load_script):
    return load_script("research/make_second_results")


def quotients(equations, method):
    """Return errors in tolerances."""
    actual = []
    for case in equations:
        for tolerance in TOLERANCES:
            run = cg.solve_ivp(
                case.f, (0, case.end), case.y0, frame=case.frame, method=method,
                rtol=tolerance, atol=tolerance,
            )  # fmt: skip
            actual.append(case.error(run.y[-1]) / tolerance)
    return actual


def test_references_of_spins(equations):
    for case in equations[:6]:
        other = cg.integrate(
            case.f, (0, case.end), case.y0, frame=case.frame, method="CF8a", h=case.end / 2048
        )
        assert case.error(other.y[-1]) < 1e-12


@pytest.mark.parametrize("name", DEFAULTS)
def test_defaults_are_honest(equations, name):
    from benchmarks.estimates import LARGEST, MEDIAN

    actual = quotients(equations, name)
    assert np.median(actual) <= MEDIAN
    assert max(actual) <= LARGEST


@pytest.mark.parametrize("name", ["BS3(2)", "DP5(4)", "DVERK6(5)", "Verner7(6)", "Verner8(7)"])
def test_second_results_with_separate_flows_estimate_splitting_errors(equations, tool, name):
    """With one flow from the result, which is the flat estimate, errors are far larger."""
    pair = cg.methods[name]
    flat = tool.flat_estimate(pair)
    assert (flat.order, flat.embedded_order) == (pair.order, pair.embedded_order)
    spins = equations[:6]
    assert np.median(quotients(spins, flat)) > 5
    assert max(quotients(spins, pair)) < 8


def test_the_tool_finds_them(tool):
    pair = cg.methods["BS3(2)"]
    assert tool.make(pair, tool.RECIPES["BS3(2)"])[0] == pair
    recipe = tool.Recipe(cg.structure.points.START, 2, 4)
    actual, error, hits = tool.make(cg.methods["DP5(4)"], recipe)
    assert hits == 4
    assert (actual.order, actual.embedded_order, actual.pair_exponentials) == (5, 4, 14)
    assert actual.exact_embedded == cg.methods["DP5(4)"].exact_embedded
    assert 0 < error == pytest.approx(actual.embedded.principal_error, rel=1e-9)


@pytest.fixture(scope="module")
def measured(equations):
    from benchmarks import page

    return page.read(ROOT / "benchmarks" / "results.json")["estimates"]


def test_defaults_follow_the_rule(measured):
    kinds = ("compiled | time", "in Python, with brackets | flows")
    for frame, kind in zip(FRAMES, (*kinds, "without brackets | evaluations + flows"), strict=True):
        loose, tight = choose_method(frame, 1e-4), choose_method(frame, 1e-8)
        assert f"| {kind} | `{loose}` | `{tight}` |" in measured.notes[0]


def test_measured_estimates_in_the_catalogue(measured, tmp_path):
    from benchmarks.estimates import BEGIN, END, stored, write_table

    text = (ROOT / "docs" / "catalogue.md").read_text(encoding="utf-8")
    page = tmp_path / "page.md"
    page.write_text(f"{BEGIN}{END}", encoding="utf-8")
    write_table(measured, page)
    assert page.read_text(encoding="utf-8") in text
    assert set(cg.methods).issuperset(stored(measured))

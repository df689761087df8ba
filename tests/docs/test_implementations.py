"""The page on other implementations matches the computed results."""

import importlib
import json
import sys
from importlib.metadata import version
from pathlib import Path

import pytest

import cg
from cg.method.tableau import Tableau

pytestmark = pytest.mark.no_core

TOOLS = Path(__file__).parents[2] / "tools"


@pytest.fixture(scope="module")
def tool():
    sys.path.insert(0, str(TOOLS))
    yield importlib.import_module("check_implementations")
    sys.path.remove(str(TOOLS))


@pytest.fixture(scope="module")
def checked(tool):
    monkeypatch = pytest.MonkeyPatch()
    monkeypatch.setattr(tool, "slope_of", lambda _: float("nan"))
    actual = [tool.check(entry) for entry in tool.read()]
    monkeypatch.undo()
    return {(c.entry["implementation"].split(" ")[0], c.entry["name"]): c for c in actual}


def without_slope(row):
    cells = row.split(" | ")
    return cells[:5] + cells[6:]


def test_page_matches_the_computed_table(tool, checked):
    page = tool.PAGE.read_text(encoding="utf-8")
    part = page.partition("<!-- table -->\n")[2].partition("<!-- end of table -->\n")[0]
    rows = part.splitlines()[2:]
    rows = rows[: rows.index("")]
    computed = tool.table(list(checked.values())).splitlines()[2:]
    assert [*map(without_slope, rows)] == [*map(without_slope, computed[: computed.index("")])]


def test_orders(checked):
    orders = {key: c.diagnosis.order for key, c in checked.items()}
    julia, manifold = "OrdinaryDiffEq.jl", "ManifoldDiffEq.jl"
    assert [orders[julia, name] for name in ("CG2", "CG3", "CG4a")] == [2, 2, 2]
    assert [orders[manifold, name] for name in ("CG2", "CG3", "CG4a")] == [2, 3, 4]
    assert [orders["DiffMan", name] for name in ("CG23", "CG43", "CG4a", "CG5a")] == [2, 4, 4, 5]
    assert [orders["Lielab", name] for name in ("CG23", "CG4a", "CG5a")] == [2, 4, 5]


def test_mistakes(checked):
    mistakes = {key: [f.kind for f in c.diagnosis.mistakes] for key, c in checked.items()}
    wrong = {key: kinds for key, kinds in mistakes.items() if kinds}
    assert wrong == {
        ("OrdinaryDiffEq.jl", "CG3"): ["reversed"],
        ("OrdinaryDiffEq.jl", "CG4a"): ["reversed"],
        ("DiffMan", "CG43"): ["equal weights"],
        ("DiffMan", "CG34"): ["equal weights"],
        ("DiffMan", "CG4test"): ["abscissae", "abscissae"],
        ("georax", "CG4"): ["abscissae", "slip"],
    }


@pytest.mark.slow
def test_slopes(tool, checked):
    for c in checked.values():
        slope = tool.slope_of(Tableau(c.entry["a"], c.entry["b"]))
        # digits that are wrong beyond the eighth don't show in the slope
        meant = c.entry["says"] if c.entry["name"] in {"CG4test", "CG4"} else c.diagnosis.order
        assert slope == pytest.approx(meant, abs=0.25), c.entry["name"]


def test_lielab_still_has_these_coefficients(checked):
    lielab = pytest.importorskip("lielab.integrate")
    for name in ("CG23", "CG4a", "CG5a"):
        kind = getattr(lielab.CrouchGrossmanCoefficients, name)
        a, b, *_ = lielab.get_crouch_grossman_coefficients(kind)
        method = checked["Lielab", name].diagnosis.method
        s = method.stages
        assert [row[:s] for row in a[:s]] == method.a.tolist()
        assert b[:s] == method.b.tolist()


def test_wrong_rational_coefficient_of_symmetric_method(checked):
    entry = checked["DiffMan", "CG4test"].entry
    right = [[x.replace("-443/2993", "-1087/7344") for x in row] for row in entry["a"]]
    assert cg.diagnose(cg.Tableau(right, entry["b"]), c=entry["c"]).order == 4


def test_page_has_the_stored_slopes(tool):
    page = tool.PAGE.read_text(encoding="utf-8")
    for name, text in (("slopes", tool.linear_table()), ("rotations", tool.rotation_table())):
        assert f"<!-- {name} -->\n{text}<!-- end of {name} -->" in page


def test_slopes_on_linear_problems_are_reproduced():
    from benchmarks import linear_test

    stored = json.loads(linear_test.DATA.read_text("utf-8"))["`CG4a` as published"]
    method = cg.methods["CG4a"]
    assert linear_test.slope_on("sin(t)", method, list(method.c)) == pytest.approx(
        stored["sin(t)"], abs=0.02
    )


def test_observed_order_of_installed_simulators_is_reproduced():
    from benchmarks import rotation_order

    stored = {
        (row["package"], row["version"], row["integrator"]): row["errors"][:3]
        for row in json.loads(rotation_order.DATA.read_text("utf-8"))
    }
    for simulator in (rotation_order.crouch_grossman, rotation_order.mujoco):
        try:
            integrators = dict(simulator())
        except ImportError:
            continue
        package = simulator.__name__.replace("_", "-")
        for name, turn in integrators.items():
            errors = stored.get((package, version(package), name))
            if errors:
                assert rotation_order.errors_of(turn, rotation_order.STEPS[:3]) == pytest.approx(
                    errors, rel=1e-3
                )

"""The page on other implementations matches the computed results."""

import pytest

from cg.method.tableau import Tableau

TOOL = "tools/check_implementations"


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

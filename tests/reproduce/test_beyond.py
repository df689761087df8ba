"""Sections of the report beyond the paper."""

import re
from pathlib import Path
from types import SimpleNamespace

import pytest
from kinds import FROZEN, MAGNUS
from refusals import refuses
from report_pages import check_page, read

from cg.construction.catalogue import methods
from cg.construction.conditions import count
from cg.construction.methods.commutator_free import CommutatorFree
from cg.construction.proofs.files import certificate_names
from cg.reproduce.context import Context, Settings
from cg.reproduce.main import main
from cg.reproduce.sections import beyond_catalogue, beyond_order
from cg.reproduce.style import LINES, lines

PAGE = Path(__file__).parents[2] / "docs" / "catalogue.md"


@pytest.fixture(scope="module")
def catalogue():
    return beyond_catalogue.compute(Context(Settings(), Path()))


def entries(catalogue):
    return {entry["name"]: entry for entry in catalogue["methods"]}


def test_catalogue_section_lists_all_methods(catalogue):
    assert sorted(entries(catalogue)) == sorted(FROZEN)
    explicit = [entry["explicit"] for entry in catalogue["methods"]]
    assert explicit == sorted(explicit, reverse=True)
    assert len(beyond_catalogue.table(catalogue).rows) == len(FROZEN)


def test_properties_of_a_known_method(catalogue):
    entry = entries(catalogue)["CG4a"]
    assert (entry["order"], entry["embedded_order"], entry["approximate"]) == (4, None, False)
    assert (entry["stages"], entry["exponentials"]) == (5, 15)
    assert entry["largest_coefficient"] == 1.3918565724203246
    assert entry["abscissae"] == [0, 0.8768903263420429]
    assert (entry["rank"], entry["conditions"]) == (13, 13)
    # the one dependent condition of CG5a is known
    assert entries(catalogue)["CG5a"]["rank"] == 37
    assert entries(catalogue)["CG2(3)"]["embedded_order"] == 2


def test_residuals_and_ranks(catalogue):
    for name, actual in entries(catalogue).items():
        assert actual["conditions"] == count(actual["order"], independent=True)
        assert 0 < actual["rank"] <= actual["conditions"]
        assert actual["approximate"] == (actual["largest_residual"] > 1e-32) == (name == "CG6a")
        assert actual["principal_error"] > 1e-5


def test_catalogue_section_shows_certificates(catalogue):
    rows = {row[0]: row[-1] for row in beyond_catalogue.table(catalogue).rows}
    proved = {name for name, actual in entries(catalogue).items() if actual["certificate"]}
    assert proved == {n for n, cell in rows.items() if cell != "–"}
    assert proved == {*certificate_names()} - {*MAGNUS}
    assert rows["CG6a"] == "–"
    assert rows["LieEuler"] == "0"
    assert rows["CG4a"].endswith("e−36")


def test_table_in_docs_matches_the_catalogue(catalogue):
    shown = beyond_catalogue.markdown(beyond_catalogue.table(catalogue))
    page = PAGE.read_text("utf-8")
    assert shown in page, "out of date; run python tools/update_catalogue.py"
    advice = page.partition("## Which method to use")[2].partition("## The table")[0]
    named = set(re.findall(r"`([A-Z]\w+(?:\(\d\)\w?)?)`", advice))
    assert len(named) > 8
    assert named <= set(methods)


RECOMMENDED = {
    "effort": "CG4b CG6f CF4c CF5d CF6b CF7b",
    "exponentials": "CG4c CG5c CG6g CF4 CF5c CF6d DOP853 CF7b",
    "stages": "CG5d CG6g CG7b CF4 CF5b CF6a CF7c CF8a",
    "principal_error": "CG5b CG6e CF4(3) CF5e",
}


@pytest.mark.parametrize(
    ("name", "by"), [(name, by) for by, names in RECOMMENDED.items() for name in names.split()]
)
def test_recommended_methods_are_best_in_their_class(catalogue, name, by):
    # Crouch–Grossman methods among themselves, others among all
    rivals = {
        other["name"]: other[by]
        for other in catalogue["methods"]
        if other["explicit"] and other["order"] == methods[name].order
        if not (name.startswith("CG") and isinstance(methods[other["name"]], CommutatorFree))
    }
    assert rivals[name] == min(rivals.values())


def test_report_has_the_catalogue_section(tmp_path, monkeypatch):
    listed = {name: methods[name] for name in ("CG4a", "CG2(3)", "ImplicitMidpoint")}
    monkeypatch.setattr(beyond_catalogue, "methods", listed)
    assert main(["--only", "beyond.catalogue", "--out", str(tmp_path)]) == 0
    item = read(tmp_path)["items"]["beyond.catalogue"]["methods"]
    assert [entry["name"] for entry in item] == ["CG2(3)", "CG4a", "ImplicitMidpoint"]
    check_page((tmp_path / "report.html").read_text("utf-8"))


def test_report_has_the_order_section(tmp_path, monkeypatch):
    monkeypatch.setattr(beyond_order, "_POWERS", range(3, 8))
    assert main(["--only", "beyond.order", "--out", str(tmp_path)]) == 0
    part = read(tmp_path)["items"]["beyond.order"]["readings"]["momentum"]
    assert 0 < part["reference_error"] < 1e-40
    assert set(part["methods"]) == set(beyond_order.select()) >= {"CG6a", "CG6b", "CG6c", "CG6d"}
    for run in part["methods"].values():
        assert len(run["h"]) == 5
        if run["approximate"]:
            assert run["error"][-1] > 1e-8
            assert run["decades"] == 0
        else:
            assert run["local"][-1] == pytest.approx(run["order"], abs=0.1)
            assert run["decades"] > 1
    parsed = check_page((tmp_path / "report.html").read_text("utf-8"))
    assert parsed.tags.count("figure") == 1


def test_line_styles_are_distinct():
    names = [f"CG6{letter}" for letter in "abcdefghijkl"]
    looks = lines(names)
    assert list(looks) == names
    assert looks["CG6a"] == LINES["CG6a"]
    assert len({tuple(map(str, look.values())) for look in looks.values()}) == len(names)
    refuses(ValueError, "there are styles for at most", lines, map(str, range(100)))


def test_order_section_has_all_methods_from_order_six():
    method = lambda order, explicit=True: SimpleNamespace(order=order, explicit=explicit)
    listed = {"a": method(7), "b": method(5), "c": method(6), "d": method(8, explicit=False)}
    assert beyond_order.select(listed) == ["c", "a"]


def test_slopes_use_decades_above_the_smallest_error():
    part = {"error": [1e-1, 1e-3, 1e-9, 1e-15], "local": [2.0, 6.05, 5.95]}
    assert beyond_order.decades(part, 6) == pytest.approx(12)
    assert beyond_order.decades(part, 7) == 0
    assert beyond_order.decades({**part, "local": [6.0, 4.0, 6.0]}, 6) == pytest.approx(6)

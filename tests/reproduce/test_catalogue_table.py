"""The table of the catalogue in the documentation, and the methods that it recommends."""

import re
from pathlib import Path

import pytest
from kinds import FROZEN

from cg.construction.catalogue import methods
from cg.construction.conditions import count
from cg.construction.methods.commutator_free import CommutatorFree
from cg.construction.proofs.files import certificate_names
from cg.reproduce import catalogue_table

PAGE = Path(__file__).parents[2] / "docs" / "catalogue.md"


@pytest.fixture(scope="module")
def catalogue():
    return {entry["name"]: entry for entry in catalogue_table.entries()}


def test_properties(catalogue):
    assert sorted(catalogue) == sorted(FROZEN)
    entry = catalogue["CG4a"]
    assert (entry["order"], entry["embedded_order"], entry["approximate"]) == (4, None, False)
    assert (entry["stages"], entry["exponentials"]) == (5, 15)
    assert entry["largest_coefficient"] == 1.3918565724203246
    # the one dependent condition of CG5a is known
    assert (entry["rank"], catalogue["CG5a"]["rank"]) == (13, 37)
    for name, actual in catalogue.items():
        assert actual["conditions"] == count(actual["order"], independent=True)
        assert 0 < actual["rank"] <= actual["conditions"]
        assert actual["approximate"] == (actual["largest_residual"] > 1e-32) == (name == "CG6a")
        assert actual["principal_error"] > 1e-5


def test_catalogue_section_shows_certificates(catalogue):
    rows = {row[0]: row[-1] for row in catalogue_table.table(catalogue.values()).rows}
    proved = {name for name, actual in catalogue.items() if actual["certificate"]}
    assert proved == {n for n, cell in rows.items() if cell != "–"}
    assert proved == {*certificate_names()} & {*FROZEN}
    assert rows["CG6a"] == "–"
    assert rows["LieEuler"] == "0"
    assert rows["CG4a"].endswith("e−36")


def test_table_in_docs_matches_the_catalogue(catalogue):
    shown = catalogue_table.markdown(catalogue_table.table(catalogue.values()))
    page = PAGE.read_text("utf-8")
    assert shown in page, "out of date; run python tools/update_catalogue.py"
    advice = page.partition("## Which method to use")[2].partition("## The table")[0]
    named = set(re.findall(r"`([A-Z]\w+(?:\(\d\)\w?)?)`", advice))
    assert len(named) > 8
    assert named <= set(methods)


RECOMMENDED = {
    "effort": "CG4b CG6f CF4r CF5d CF6b CF7b",
    "exponentials": "CG4c CG5c CG6g CF4 CF5c CF6d DOP853 CF7b",
    "stages": "CG5d CG6g CG7b CF4 CF5b CF6a CF7c CF8a",
    "principal_error": "CG5b CG6e CF4r CF5e",
}


@pytest.mark.parametrize(
    ("name", "by"), [(name, by) for by, names in RECOMMENDED.items() for name in names.split()]
)
def test_recommended_methods_are_best_in_their_class(catalogue, name, by):
    # Crouch–Grossman methods among themselves, others among all
    rivals = {
        other["name"]: other[by]
        for other in catalogue.values()
        if other["explicit"] and other["order"] == methods[name].order
        if not (name.startswith("CG") and isinstance(methods[other["name"]], CommutatorFree))
    }
    assert rivals[name] == min(rivals.values())

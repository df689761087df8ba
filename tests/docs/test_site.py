"""The front page, the gallery, the pages of methods, and search terms."""

import importlib
import re
import runpy
from pathlib import Path

import pytest

import cg

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
GALLERY = sorted(path.stem for path in (DOCS / "gallery").glob("plot_*.py"))
FAST = {"plot_drift", "plot_lattice", "plot_stability", "plot_trees", "plot_vortices"}
PAGES = [*DOCS.glob("*.md"), *(DOCS / "start").glob("*.md"), *(DOCS / "howto").glob("*.md")]


@pytest.fixture(scope="module")
def from_docs():
    """Return a module of the folder docs."""
    monkeypatch = pytest.MonkeyPatch()
    monkeypatch.syspath_prepend(str(DOCS))
    pytest.importorskip("matplotlib").use("Agg")
    yield importlib.import_module
    monkeypatch.undo()


@pytest.mark.parametrize(
    "name", [pytest.param(n, marks=[] if n in FAST else [pytest.mark.slow]) for n in GALLERY]
)
def test_program_of_gallery_draws_a_figure(name, monkeypatch):
    monkeypatch.syspath_prepend(DOCS / "gallery")
    pytest.importorskip("matplotlib").use("Agg")
    from matplotlib import pyplot as plt

    runpy.run_path(str(DOCS / "gallery" / f"{name}.py"))
    assert all(ax.has_data() for ax in plt.gcf().axes)
    plt.close("all")


def test_links_and_pictures_exist_in_the_source_tree():
    for page in [*ROOT.glob("*.md"), *PAGES, *DOCS.glob("mathematics/*.md")]:
        targets = re.findall(r"\]\(([^)#\s:]+)(?:#[^)\s]*)?\)", page.read_text("utf-8"))
        assert [t for t in targets if not (page.parent / t).exists()] == [], page


def test_pages_of_methods(from_docs):
    pages = from_docs("method_pages")
    for name, method in cg.methods.items():
        words, sentences = pages.proof(method)
        assert (words == "yes") == ("is proved:" in sentences.replace("**", "")), name
        assert pages.coefficients(method).startswith("| "), name
        *entries, last = pages.citations(method)
        assert f"method {name}}}" in last
        assert all("year = {" in entry for entry in (*entries, last)), name
        if re.search(r"\b(19|20)\d\d\b", method.source or ""):
            assert entries, name
    assert pages.proof(cg.methods["CG6a"])[0] == "no"
    assert pages.proof(cg.methods["DOP853"])[0] == "in part"
    assert "Munthe-Kaas1999" in "".join(pages.citations(cg.methods["RKMK8(5,3)"]))


def test_list_of_methods_has_a_row_for_each(from_docs):
    pages = from_docs("method_pages")
    listed = pages.index([cg.methods["CG4a"], cg.methods["RKMK5(4)"]])
    assert "| [CG4a](CG4a.md) | Crouch–Grossman | 4 | 5 | 15 | 0.078 | yes |" in listed
    assert "| [RKMK5(4)](RKMK5_4.md) | Munthe-Kaas | 5(4) | 7 | 6 |" in listed


def test_table_of_the_catalogue_leads_to_the_pages_of_methods(from_docs):
    pages, content = from_docs("method_pages"), [(DOCS / "catalogue.md").read_text("utf-8")]
    pages.link_table(None, "catalogue", content)
    links = re.findall(r"^\| \[(.+)\]\(methods/(.+)\.md\)", content[0], re.MULTILINE)
    assert len(links) > 60
    assert all(pages.slug(name) == page and name in cg.methods for name, page in links)

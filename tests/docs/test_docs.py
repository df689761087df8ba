"""The code of the documentation runs; links, pages of methods and the gallery."""

import importlib
import re
import runpy
import subprocess
import sys
from pathlib import Path

import matplotlib
import numpy as np
import pytest
from kinds import FROZEN

import cg
from cg.integration.default_method import choose_method

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"


def matches(pattern, page):
    text = (ROOT / page).read_text(encoding="utf-8")
    return re.findall(pattern, text, re.DOTALL | re.MULTILINE)


def blocks_of(page):
    """Return pairs (kind, text) of blocks of Python; the kind is the word after the language."""
    return matches(r"^```python *(\w*)\n(.*?)^```", page)


def source_in(page, language):
    """Return the text of the only block of a page in some other language than Python."""
    (source,) = matches(rf"^```{language}\n(.*?)^```", page)
    return source


def run(page, kind="", names=None):
    """Run all blocks of a kind in order, and return the names that they define."""
    names = {} if names is None else names
    for number, (this, block) in enumerate(blocks_of(page)):
        if this == kind:
            exec(compile(block, f"{page}, block {number + 1}", "exec"), names)
    return names


IN_JAX = {"howto/batch", "howto/densities", "howto/jax", "howto/jaxlie", "howto/neural_ode"}
IN_JAX |= {"howto/pulse", "howto/quadrotor"}
NEEDED = {"howto/jaxlie": "jaxlie", "howto/linear": "qutip"}
NEEDED |= {"howto/casadi": "casadi", "howto/conventions": "mujoco pinocchio"}
SLOW = IN_JAX | {"howto/monte_carlo", "howto/optimal_turn"}
PAGES = sorted(
    str(path.relative_to(DOCS).with_suffix(""))
    for folder in ("start", "howto", "mathematics")
    for path in (DOCS / folder).glob("*.md")
)


@pytest.mark.parametrize("page", [
    pytest.param(page, marks=[pytest.mark.slow] if page in SLOW else [])
    for page in PAGES
    if page != "howto/compiled"
])  # fmt: skip
def test_code_of_page_runs(page, capsys, monkeypatch):
    monkeypatch.syspath_prepend(DOCS / "gallery")
    if page in IN_JAX:
        pytest.importorskip("diffrax", reason="diffrax is not installed")
    for package in NEEDED.get(page, "").split():
        pytest.importorskip(package, reason=f"{package} is not installed")
    names = run(f"docs/{page}.md")
    if "numba" in {kind for kind, _ in blocks_of(f"docs/{page}.md")}:
        pytest.importorskip("numba")
        run(f"docs/{page}.md", "numba", names)
    printed = capsys.readouterr()
    assert printed.err == ""
    if page not in IN_JAX:  # whose last digits differ between processors
        for output in matches(r"^```text\n(.*?)^```", f"docs/{page}.md"):
            assert output in printed.out


def test_right_hand_sides_in_c(tmp_path, monkeypatch):
    """The program in C of the page on compiled right-hand sides is compiled as the page says."""
    page = "docs/howto/compiled.md"
    (tmp_path / "turn.c").write_text(source_in(page, "c"), encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    warnings = ["-Wall", "-Wextra", "-Wno-unused-parameter", "-Werror"]
    (command,) = matches(r"^    (cc [^\n]*)$", page)  # the only line that calls the compiler
    subprocess.run([*command.split(), *warnings], check=True)
    assert run(page)["in_c"].success


def test_right_hand_sides_in_numba():
    pytest.importorskip("numba")
    names = run("docs/howto/compiled.md", "numba")
    assert names["by_numba"].success
    expected = cg.solve_ivp(
        lambda t, y: [0.0, np.sin(t), y[0, 0]], (0, 5), np.eye(3), frame=cg.frames.SO3(), rtol=1e-9,
        atol=1e-9,
    )  # fmt: skip
    np.testing.assert_allclose(names["by_numba"].y[-1], expected.y[-1], atol=1e-12)


@pytest.mark.slow
def test_right_hand_sides_in_cython(tmp_path, monkeypatch):
    pytest.importorskip("Cython")
    source = source_in("docs/howto/compiled.md", "cython")
    (tmp_path / "turning.pyx").write_text(source, encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    subprocess.run(
        [sys.executable, "-m", "Cython.Build.Cythonize", "-i", "-3", "turning.pyx"], check=True
    )
    monkeypatch.syspath_prepend(str(tmp_path))
    names = run("docs/howto/compiled.md", "cython")
    assert names["by_cython"].success


def test_methods_with_stages_outside_the_step_are_listed():
    text = (DOCS / "catalogue.md").read_text("utf-8")
    (names,) = [part for part in text.split("\n\n") if part.startswith("Only these methods call")]
    beyond = {
        name
        for name, method in FROZEN.items()
        if method.explicit and not (min(method.c) >= 0.0 and max(method.c) <= 1.0)
    }
    assert set(re.findall(r"`(C[FG].*?)`", names)) == beyond
    start = (DOCS / "start" / "from_solve_ivp.md").read_text("utf-8")
    assert len(beyond) == 10
    assert "but for ten [methods with stages outside the step]" in start
    for frame in (cg.frames.SO3(), cg.frames.Stiefel(3, 1), cg.frames.Sphere(3)):
        assert not {choose_method(frame, rtol) for rtol in (1e-3, 1e-8)} & beyond


MARKDOWN = [page for page in ROOT.glob("docs/**/*.md") if page.parent.name != "methods"]


def test_export_page():
    names = run("docs/export.md")
    assert names["difference"] < 1e-14
    assert names["header"] == cg.export("CF4", "c", frame=cg.frames.SO3())
    assert "booktabs" in names["table"]
    assert names["solution"].method.name == "Ralston"


def test_c_program_of_export_page(tmp_path):
    (tmp_path / "program.c").write_text(source_in("docs/export.md", "c"), encoding="utf-8")
    header = cg.export("CF4", "c", frame=cg.frames.SO3())
    (tmp_path / "cf4.h").write_text(header, encoding="utf-8")
    flags = ["-std=c99", "-Wall", "-Wextra", "-Wno-unused-parameter", "-Werror"]
    subprocess.run(["gcc", *flags, "program.c", "-o", "program", "-lm"], check=True, cwd=tmp_path)
    process = subprocess.run([tmp_path / "program"], capture_output=True, text=True, check=True)
    assert float(process.stdout) == pytest.approx(0.5, abs=1e-14)


def test_plots_page(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    names = run("docs/plots.md")
    assert (tmp_path / "cf4.png").stat().st_size > 1000
    assert names["ax"].get_ylabel() == "speed (m/s)"
    rows = [row.get_text() for row in names["events"].get_yticklabels()]
    assert rows == ["mode", "impact", "lift"]
    plt.close("all")
    page = (ROOT / "docs/plots.md").read_text(encoding="utf-8")
    assert all(f"`{name}(" in page for name in cg.plot.__all__)


def test_pages_show_the_pictures_that_are_drawn():
    drawn = runpy.run_path(str(ROOT / "docs/pictures.py"))["PICTURES"]
    pages = [page.read_text(encoding="utf-8") for page in MARKDOWN]
    shown = re.findall(r"\((?:\.\./)?pictures/(\w+)\.png\)", "".join(pages))
    assert set(shown) == set(drawn)


@pytest.mark.parametrize("page", ["implicit", "searches"])
def test_tables_have_the_numbers_of_the_methods(page):
    """Columns of largest coefficients and principal errors, to the digits that are given."""
    head, count = [], 0
    for line in (DOCS / f"{page}.md").read_text("utf-8").splitlines():
        cells = [cell.strip(" `") for cell in line.strip("|").split("|")] * line.startswith("|")
        head = (head or cells) if cells else []
        name = cells[0].split(",")[0] if cells else ""
        if not {"principal error", "largest coefficient"} <= set(head) or name not in cg.methods:
            continue
        count += 1
        text = dict(zip(head, cells, strict=True))
        number = text["principal error"].replace("·10⁻", "e-")
        number = number.translate(str.maketrans("²³⁴", "234"))
        assert float(number) == pytest.approx(cg.methods[name].principal_error, rel=0.05)
        if name != "CG6(5)":  # whose largest one is a second weight
            largest = max(abs(float(one.value)) for one in cg.methods[name].coefficients)
            assert float(text["largest coefficient"]) == pytest.approx(largest, abs=0.006)
    assert count >= 5


def test_code_of_readme_runs():
    assert len(blocks_of("README.md")) == 3
    names = run("README.md")
    assert names["solution"].success
    assert {method.order for method in names["four"]} == {4}
    assert {method.order for method in names["free"]} == {5}
    assert names["five"].order == 5
    assert names["proof"].order == names["method"].order == 6


def test_code_of_frames_page(capsys):
    names = run("docs/frames.md")
    assert capsys.readouterr().out == source_in("docs/frames.md", "text")
    spiral = names["spiral"]
    # latitude: z' = -(1 - z^2) / 2; longitude grows with time
    z = -np.tanh(spiral.t / 2)
    expected = np.stack([np.cos(spiral.t), np.sin(spiral.t), z], axis=-1)
    expected[:, :2] *= np.sqrt(1 - z * z)[:, None]
    np.testing.assert_allclose(spiral.y, expected, atol=1e-7)

    eigenvalues, vectors = np.linalg.eigh(names["lattice"])
    np.testing.assert_allclose(names["sorted_"].y[-1], np.diag(eigenvalues[::-1]), atol=1e-5)
    columns = names["columns"].y[-1]
    np.testing.assert_allclose(columns @ columns.T, vectors[:, 1:] @ vectors[:, 1:].T, atol=1e-5)
    momentum, vertical = names["top"].y[:, :3], names["top"].y[:, 3:]
    np.testing.assert_allclose(np.vecdot(vertical, vertical), 1.0, atol=1e-14)
    np.testing.assert_allclose(np.vecdot(momentum, vertical), 1.32, atol=1e-14)
    assert names["course"].success


def test_code_of_pages_on_problems_and_methods():
    assert run("docs/problems.md")["error"] < 1e-8
    assert run("docs/lifting.md")["lifted"].flows == 4
    assert run("docs/low_storage.md")["williamson"].order == 3
    assert run("docs/rkmk.md")["heun"].order == 2


def test_code_of_pages_on_searches(capsys, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    names = run("docs/runs.md")
    result, (first, kind, _) = names["result"], capsys.readouterr().out.splitlines()
    assert first == repr(result)
    assert sum(start.exact for start in result.starts) > 10
    assert kind == "search 4 200"

    names = run("docs/making.md")
    files = {"runs.jsonl", "Mine.toml", "Mine.certificate.toml"}
    assert {path.name for path in tmp_path.iterdir()} == files
    method, lines = names["method"], capsys.readouterr().out.splitlines()
    assert names["certificate"].order == method.order == 4
    assert lines[:2] == [first, f"{method.name} {method.principal_error}"]
    assert method.c.max() <= 1.0


GALLERY = sorted(path.stem for path in (DOCS / "gallery").glob("plot_*.py"))
FAST = {"plot_drift", "plot_lattice", "plot_stability", "plot_trees", "plot_vortices"}
WITH_LINKS = [*DOCS.glob("*.md"), *(DOCS / "start").glob("*.md"), *(DOCS / "howto").glob("*.md")]


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
    for page in [*ROOT.glob("*.md"), *WITH_LINKS, *DOCS.glob("mathematics/*.md")]:
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

"""The code blocks of the start, how-to and mathematics pages run in order."""

import re
import runpy
import subprocess
import sys
from pathlib import Path

import matplotlib
import numpy as np
import pytest
from kinds import FROZEN
from tests_of_pages import ROOT, blocks_of, compiler_command, run, source_in

import cg
from cg.integration.default_method import choose_method

DOCS = Path(__file__).parents[2] / "docs"
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


@pytest.mark.parametrize(
    "page",
    [
        pytest.param(page, marks=[pytest.mark.slow] if page in SLOW else [])
        for page in PAGES
        if page != "howto/compiled"
    ],
)
def test_code_of_page_runs(page, capsys, monkeypatch):
    monkeypatch.syspath_prepend(DOCS / "gallery")
    if page in IN_JAX:
        pytest.importorskip("diffrax", reason="diffrax is not installed")
    for package in NEEDED.get(page, "").split():
        pytest.importorskip(package, reason=f"{package} is not installed")
    names = run(f"docs/{page}.md")
    if "numba" in {kind for kind, _ in blocks_of(f"docs/{page}.md")}:
        numba = pytest.importorskip("numba")
        assert numba
        run(f"docs/{page}.md", "numba", names)
    printed = capsys.readouterr()
    assert printed.err == ""
    if page not in IN_JAX:  # whose last digits differ between processors
        text = (DOCS / f"{page}.md").read_text("utf-8")
        for output in re.findall(r"^```text\n(.*?)^```", text, re.DOTALL | re.MULTILINE):
            assert output in printed.out


@pytest.fixture
def in_c(tmp_path, monkeypatch):
    """The program in C of the page on compiled right-hand sides, compiled as the page says."""
    page = "docs/howto/compiled.md"
    (tmp_path / "turn.c").write_text(source_in(page, "c"), encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    warnings = ["-Wall", "-Wextra", "-Wno-unused-parameter", "-Werror"]
    subprocess.run([*compiler_command(page), *warnings], check=True)
    return run("docs/howto/compiled.md")


def test_right_hand_sides_in_c(in_c):
    assert in_c["in_c"].success


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
    (names,) = [part for part in text.split("\n\n") if part.startswith("Stages outside the step")]
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
    assert [row.get_text() for row in names["events"].get_yticklabels()] == [
        "mode",
        "impact",
        "lift",
    ]
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
    head, found = [], 0
    for line in (DOCS / f"{page}.md").read_text("utf-8").splitlines():
        cells = [cell.strip(" `") for cell in line.strip("|").split("|")] * line.startswith("|")
        head = (head or cells) if cells else []
        name = cells[0].split(",")[0] if cells else ""
        if not {"principal error", "largest coefficient"} <= set(head) or name not in cg.methods:
            continue
        found += 1
        text = dict(zip(head, cells, strict=True))
        number = text["principal error"].replace("·10⁻", "e-")
        number = number.translate(str.maketrans("²³⁴", "234"))
        assert float(number) == pytest.approx(cg.methods[name].principal_error, rel=0.05)
        if name != "CG6(5)":  # whose largest one is a second weight
            largest = max(abs(float(one.value)) for one in cg.methods[name].coefficients)
            assert float(text["largest coefficient"]) == pytest.approx(largest, abs=0.006)
    assert found >= 5

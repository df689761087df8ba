"""The code in the pages on export and plots runs."""

import re
import runpy
import subprocess

import matplotlib
import pytest
from tests_of_pages import ROOT, run, source_in

import cg

PAGES = [page for page in ROOT.glob("docs/**/*.md") if page.parent.name != "methods"]


def test_export_page():
    names = run("docs/export.md")
    assert names["difference"] < 1e-14
    assert names["header"] == cg.export("CF4", "c")
    assert "booktabs" in names["table"]
    assert names["run"].method.name == "Ralston"


def test_c_program_of_export_page(tmp_path):
    (tmp_path / "program.c").write_text(source_in("docs/export.md", "c"), encoding="utf-8")
    (tmp_path / "cf4.h").write_text(cg.export("CF4", "c"), encoding="utf-8")
    flags = ["-std=c99", "-Wall", "-Wextra", "-Wno-unused-parameter", "-Werror"]
    subprocess.run(["gcc", *flags, "program.c", "-o", "program"], check=True, cwd=tmp_path)
    process = subprocess.run([tmp_path / "program"], capture_output=True, text=True, check=True)
    assert float(process.stdout) == pytest.approx(0.5, abs=1e-14)


def test_plots_page(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    names = run("docs/plots.md")
    assert (tmp_path / "cf4.png").stat().st_size > 1000
    assert names["ax"].get_ylabel() == "Euler angles (°)"
    plt.close("all")
    page = (ROOT / "docs/plots.md").read_text(encoding="utf-8")
    assert all(f"`{name}(" in page for name in cg.plot.__all__)


def test_pages_show_the_pictures_that_are_drawn():
    drawn = runpy.run_path(str(ROOT / "docs/pictures.py"))["PICTURES"]
    pages = [page.read_text(encoding="utf-8") for page in PAGES]
    shown = re.findall(r"\((?:\.\./)?pictures/(\w+)\.png\)", "".join(pages))
    assert set(shown) == set(drawn)

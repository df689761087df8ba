"""What the pages on exports and pictures show can be run as it stands."""

import importlib.util
import subprocess
import warnings

import matplotlib
import pytest
from test_readme import HERE, blocks_of, run

import cg

pytestmark = pytest.mark.no_core


def test_the_page_on_exports():
    names = run("docs/export.md")
    assert names["difference"] < 1e-14
    assert names["header"] == cg.export("CF4", "c")
    assert "booktabs" in names["table"]
    assert names["run"].method.name == "Ralston"


@pytest.mark.slow
def test_the_page_on_jax():
    if importlib.util.find_spec("jax") is None:
        pytest.skip("jax isn't installed")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        assert abs(float(run("docs/export.md")["of_jax"]())) > 0


def test_the_program_in_c(tmp_path):
    (source,) = blocks_of("docs/export.md", "c")
    (tmp_path / "program.c").write_text(source, encoding="utf-8")
    (tmp_path / "cf4.h").write_text(cg.export("CF4", "c"), encoding="utf-8")
    flags = ["-std=c99", "-Wall", "-Wextra", "-Wno-unused-parameter", "-Werror"]
    subprocess.run(["gcc", *flags, "program.c", "-o", "program"], check=True, cwd=tmp_path)
    found = subprocess.run([tmp_path / "program"], capture_output=True, text=True, check=True)
    assert float(found.stdout) == pytest.approx(0.5, abs=1e-14)


def test_the_page_on_pictures(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    names = run("docs/plots.md")
    assert (tmp_path / "cf4.png").stat().st_size > 1000
    assert names["ax"].name == "3d"
    plt.close("all")
    page = (HERE / "docs/plots.md").read_text(encoding="utf-8")
    for picture in (HERE / "docs/plots").glob("*.png"):
        assert f"(plots/{picture.name})" in page
        assert picture.stat().st_size < 50_000
    assert all(f"`{name}(" in page for name in cg.plot.__all__)

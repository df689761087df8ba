"""The two names of the package, and the unrelated distribution `cg`."""

import importlib
import os
import re
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import lazy_loader
import pytest

import cg
import crouch_grossman
import crouch_grossman.frames.rotations

pytestmark = pytest.mark.no_core

ROOT = Path(cg.__file__).parents[1]
ALIAS = ROOT / "crouch_grossman"
of_the_source_tree = pytest.mark.skipif(
    not (ROOT / "meson.build").exists(), reason="not in the source tree"
)


def python(code, folder):
    """Run code where the editable install isn't seen, with a folder on the path."""
    return subprocess.run(
        [sys.executable, "-S", "-c", f"import sys; sys.path.insert(0, {str(folder)!r})\n{code}"],
        capture_output=True, text=True, cwd=folder, env={**os.environ, "PYTHONPATH": ""},
        check=False,
    )  # fmt: skip


@of_the_source_tree
@pytest.mark.parametrize("name", ["compile_tables", "make_reference_steps", "update_catalogue"])
def test_scripts_find_what_they_import(name, tmp_path):
    code = f"import runpy; runpy.run_path({str(ROOT / 'tools' / name)!r} + '.py')"
    subprocess.run([sys.executable, "-c", code], cwd=tmp_path, check=True)


def test_crouch_grossman_is_cg():
    assert crouch_grossman is cg
    assert crouch_grossman.frames is cg.frames
    assert sys.modules["crouch_grossman.frames.rotations"] is sys.modules["cg.frames.rotations"]
    assert cg.frames.rotations.__spec__.name == "cg.frames.rotations"
    with pytest.raises(ModuleNotFoundError, match=r"crouch_grossman\.nothing"):
        importlib.import_module("crouch_grossman.nothing")
    code = "from crouch_grossman.command import main; main()"
    command = [sys.executable, "-c", code, "--help"]
    assert b"Usage" in subprocess.run(command, capture_output=True, check=True).stdout


def test_replaced_modules_are_reported(tmp_path):
    (tmp_path / "cg").mkdir()
    shutil.copytree(ALIAS, tmp_path / "crouch_grossman")
    run = python("import crouch_grossman", tmp_path)
    assert run.returncode == 1
    assert "pip uninstall --yes cg crouch-grossman" in run.stderr
    assert str(tmp_path) in run.stderr


@of_the_source_tree
def test_source_tree_without_build_is_reported(tmp_path):
    shutil.copytree(ROOT / "cg", tmp_path / "cg", ignore=shutil.ignore_patterns("*.so", "*.toml"))
    packages = Path(lazy_loader.__file__).parents[1]
    run = python(f"sys.path.append({str(packages)!r})\nimport cg", tmp_path)
    assert run.returncode == 1
    assert "is not built" in run.stderr.splitlines()[-1]
    assert "make build" in run.stderr.splitlines()[-1]


@of_the_source_tree
def test_versions_agree():
    (built,) = re.findall(r"^  version: '(.*)'", (ROOT / "meson.build").read_text(), re.MULTILINE)
    (cited,) = re.findall(r"^version: (.*)$", (ROOT / "CITATION.cff").read_text(), re.MULTILINE)
    recipe = (ROOT / "packaging" / "conda" / "recipe.yaml").read_text()
    (packaged,) = re.findall(r"^  version: ([\w.]+)$", recipe, re.MULTILINE)
    assert built == cited == packaged == cg.__version__


@of_the_source_tree
def test_conda_recipe_has_the_requirements_of_the_project():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())
    recipe = (ROOT / "packaging" / "conda" / "recipe.yaml").read_text()
    host, run = re.search(r"  host:\n(.*?)  run:\n(.*?)\n\n", recipe, re.DOTALL).groups()
    listed = {line.strip("- ").replace(" ", "") for line in run.splitlines()}
    needed = {
        text.replace("matplotlib", "matplotlib-base") for text in project["project"]["dependencies"]
    } | set(project["project"]["optional-dependencies"]["proofs"])
    assert listed == needed | {f"python{project['project']['requires-python']}"}
    built_with = {line.strip("- ").replace(" ", "") for line in host.splitlines()}
    assert built_with == {"python", "pip", *project["build-system"]["requires"]}

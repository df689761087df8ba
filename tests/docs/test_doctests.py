"""Doctests pass, public objects have examples, and members of frames and methods docstrings."""

import doctest
import importlib
import inspect
import pkgutil
import re
import sys
from importlib.util import find_spec
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

import cg
import cg.construction.methods

REFERENCE = Path(__file__).parents[2] / "docs" / "reference"
SKIPPED = ("cg.reproduce", "cg.construction.catalogue.certificates")
OPTIONAL = {"cg.jax": "diffrax", "cg.qutip": "qutip", "cg.construction.conditions.exact": "sympy"}
NAMES = sorted(
    module.name
    for module in pkgutil.walk_packages(cg.__path__, "cg.")
    if not module.name.startswith(SKIPPED)
    and not module.name.endswith("__main__")
    and not module.name.rpartition(".")[2].startswith("_")
)


@pytest.fixture
def draw_into_memory(monkeypatch):
    """Draw the figures of examples into memory."""
    monkeypatch.setenv("MPLBACKEND", "Agg")
    if "matplotlib" in sys.modules:
        importlib.import_module("matplotlib").use("Agg")
    yield
    if "matplotlib.pyplot" in sys.modules:
        sys.modules["matplotlib.pyplot"].close("all")


@pytest.mark.usefixtures("draw_into_memory")
@pytest.mark.parametrize("name", NAMES)
def test_doctests_of_module(name):
    for start, package in OPTIONAL.items():
        if name.startswith(start):
            pytest.importorskip(package)
    module = importlib.import_module(name)
    finder, runner = doctest.DocTestFinder(), doctest.DocTestRunner(optionflags=doctest.ELLIPSIS)
    output = []
    with np.printoptions():
        for test in finder.find(module):
            runner.run(test, out=output.append)
    assert runner.failures == 0, "".join(output)


def resolved(name):
    target = cg
    for part in name.split(".")[1:]:
        target = getattr(target, part)
    return target


def offered():
    """Return the public names of `cg`, and the modules that it lists."""
    names = {f"cg.{name}" for name in cg.__all__}
    for name in sorted(names):
        if isinstance(actual := resolved(name), ModuleType):
            names |= {f"{name}.{inner}" for inner in actual.__all__}
    return names


def in_reference():
    """Return the names in the reference."""
    names = set()
    for page in REFERENCE.glob("*.md"):
        text = page.read_text(encoding="utf-8")
        for module, listed in re.findall(
            r"currentmodule:: (\S+)\n+\.\. autosummary::\n(.*?)```", text, re.DOTALL
        ):
            names |= {f"{module}.{name}" for name in re.findall(r"^ {3}(\w\S*)$", listed, re.M)}
    return names


def public():
    """Return all public objects by name."""
    names = sorted(offered() | in_reference())
    return {
        name: resolved(name)
        for name in names
        if find_spec("diffrax") or not name.startswith("cg.jax.")
    }


def examples_of(target):
    """Return the examples of an object, for a value those of its class."""
    if not hasattr(target, "__qualname__"):
        target = type(target)
    module = importlib.import_module(target.__module__)
    if module.__name__ not in NAMES:
        return []
    expected = f"{target.__module__}.{target.__qualname__}"
    return [
        example
        for test in doctest.DocTestFinder(recurse=True).find(module)
        if test.name == expected
        for example in test.examples
        if not example.options.get(doctest.SKIP)
    ]


def test_public_objects_include_known_names():
    names = set(public())
    assert {"cg.Tableau", "cg.frames.Sphere", "cg.plot.tree", "cg.conditions.count"} <= names
    assert {"cg.construction.trees.OrderedTree", "cg.MissingQuadsError", "cg.methods"} <= names
    assert len(names) > 100


def test_public_objects_have_examples():
    assert [
        name
        for name, actual in public().items()
        if not isinstance(actual, ModuleType | int) and not examples_of(actual)
    ] == []


def test_reference_lists_all_public_names():
    told_elsewhere = {"cg.methods"} | {f"cg.conditions.{name}" for name in cg.conditions.__all__}
    modules = {name for name in offered() if isinstance(resolved(name), ModuleType)}
    assert offered() - told_elsewhere - modules <= in_reference()


MODULES = [
    module.name
    for package in (cg.frames, cg.construction.methods)
    for module in pkgutil.walk_packages(package.__path__, f"{package.__name__}.")
]


@pytest.mark.parametrize("name", MODULES)
def test_members_have_docstrings(name):
    module = __import__(name, fromlist=["*"])
    kinds = [kind for _, kind in inspect.getmembers(module, inspect.isclass)]
    for kind in (kind for kind in kinds if kind.__module__ == name):
        for member, value in vars(kind).items():
            if member.startswith("_") or not hasattr(value, "__get__"):
                continue
            found = (vars(base).get(member) for base in kind.__mro__)
            assert any(getattr(each, "__doc__", None) for each in found), (kind, member)

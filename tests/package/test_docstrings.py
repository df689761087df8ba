"""Public members of frames and methods have docstrings, their own or those of a base class."""

import inspect
from pkgutil import walk_packages

import pytest

import cg.construction.methods
import cg.frames

pytestmark = pytest.mark.no_core

MODULES = [
    module.name
    for package in (cg.frames, cg.construction.methods)
    for module in walk_packages(package.__path__, f"{package.__name__}.")
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

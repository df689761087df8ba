"""The examples in docstrings of all modules run, and give what they say."""

import doctest
import importlib
import pkgutil

import numpy as np
import pytest

import cg

SLOW = {"cg.random_search", "cg.construction.construct", "cg.lifting.lift"}
SKIPPED = ("cg.reproduce", "cg.catalogue.certificates")
NAMES = sorted(
    module.name
    for module in pkgutil.walk_packages(cg.__path__, "cg.")
    if not module.name.startswith(SKIPPED)
    and not module.name.endswith("__main__")
    and not module.name.rpartition(".")[2].startswith("_")
)


def test_all_modules_are_found():
    assert {"cg.trees", "cg.frames.so3", "cg.integration.ivp", "cg.quad"} <= set(NAMES)


@pytest.mark.parametrize("name", NAMES)
def test_the_examples_of_a_module(name):
    module = importlib.import_module(name)
    finder, runner = doctest.DocTestFinder(), doctest.DocTestRunner(optionflags=doctest.ELLIPSIS)
    told = []
    with np.printoptions():
        for test in finder.find(module):
            runner.run(test, out=told.append)
    assert runner.failures == 0, "".join(told)

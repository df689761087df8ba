"""Every public object and every exception goes through pickle and deepcopy."""

import copy
import ctypes.util
import dataclasses
import importlib
import inspect
import pickle
import pkgutil
import re
from dataclasses import fields, is_dataclass
from enum import Enum

import numpy as np
import pytest
from argument_examples import FUNCTION_EXAMPLES
from frame_argument_examples import FRAME_EXAMPLES

import cg
from cg import frames, problems

COPIES = {"pickle": lambda x: pickle.loads(pickle.dumps(x)), "deepcopy": copy.deepcopy}
ABSTRACT = {cg.Method, frames.Frame, frames.MatrixGroup, frames.HomogeneousSpace}
MODULES = [
    importlib.import_module(module.name)
    for module in pkgutil.walk_packages(cg.__path__, "cg.")
    if not module.name.startswith(("cg.jax", "cg._core", "cg.qutip", "cg.reproduce"))
    and not module.name.endswith("__main__")
]
ERRORS = {
    value
    for module in MODULES
    for _, value in inspect.getmembers(module, inspect.isclass)
    if issubclass(value, BaseException) and value.__module__.startswith("cg.")
}
CLASSES = {
    value
    for module in (cg, frames, problems)
    for value in (getattr(module, name) for name in module.__all__)
    if inspect.isclass(value) and value not in ERRORS | ABSTRACT
}
# One of a value of each kind that a constructor may ask for, by its annotation
ARGUMENTS = {"str": "a reason", "int": 3, "float": 0.125}


def examples():
    """Yield objects by name: methods, and all that the calls of everything public return."""
    for kind in (cg.Tableau, cg.CommutatorFree, cg.MuntheKaas, cg.MagnusMethod, cg.Splitting):
        yield next((name, m) for name, m in cg.methods.items() if isinstance(m, kind))
    libm = ctypes.util.find_library("m")
    yield "CompiledFunction", cg.CompiledFunction(libm, "nextafter", [1.0, 2.0])
    yield "Structure", cg.Structure.MIDDLE
    yield "Reference", problems.FreeRigidBody().reference([1])
    for name, example in (FUNCTION_EXAMPLES | FRAME_EXAMPLES).items():
        dense = {"dense_output": True} if "dense_output" in example.arguments else {}
        result = example.function(**(example.arguments | dense))
        if type(result).__module__.startswith("cg."):
            yield name, result
            if dense:
                yield f"the output of {name}", result.sol
            if getattr(result, "adjoint", None):
                yield f"the adjoint of {name}", result.adjoint


EXAMPLES = dict(examples())


def assert_same(one, other):
    assert type(one) is type(other)
    if isinstance(one, np.ndarray):
        np.testing.assert_array_equal(one, other)
        assert one.flags.writeable == other.flags.writeable
    elif isinstance(one, list | tuple):
        assert len(one) == len(other)
        for pair in zip(one, other, strict=True):
            assert_same(*pair)
    elif isinstance(one, dict):
        assert_same(list(one.items()), list(other.items()))
    elif type(one).__module__.startswith("cg.") and not isinstance(one, Enum):
        names = [each.name for each in fields(one)] if is_dataclass(one) else vars(one)
        public = [name for name in names if not name.startswith("_")]
        assert_same([getattr(one, n) for n in public], [getattr(other, n) for n in public])
        assert repr(one) == repr(other)
        if callable(one):
            assert_same(one(0.25), other(0.25))
    else:
        assert one == other or one != one


def test_the_examples_contain_every_public_class():
    assert {type(example) for example in EXAMPLES.values()} >= CLASSES


@pytest.mark.parametrize("copied", COPIES.values(), ids=COPIES)
@pytest.mark.parametrize("example", EXAMPLES.values(), ids=EXAMPLES)
def test_objects(example, copied):
    assert_same(example, copied(example))


@pytest.mark.parametrize("copied", COPIES.values(), ids=COPIES)
@pytest.mark.parametrize("kind", sorted(ERRORS, key=str), ids=lambda kind: kind.__name__)
def test_exceptions(kind, copied):
    own = kind.__init__ if inspect.isfunction(kind.__init__) else lambda self, message: None
    parameters = list(inspect.signature(own).parameters.values())[1:]
    positional = [p for p in parameters if p.kind is p.POSITIONAL_OR_KEYWORD]
    named = {"radius": 0.5} if len(positional) < len(parameters) else {}
    error = kind(*(ARGUMENTS.get(p.annotation, "a message") for p in positional), **named)
    again = copied(error)
    assert type(again) is kind
    assert str(again) == str(error)
    assert vars(again) == vars(error)


def classes():
    for module in pkgutil.walk_packages(cg.__path__, "cg."):
        if module.name.endswith("__main__"):
            continue
        try:
            imported = importlib.import_module(module.name)
        except ImportError as error:
            if not re.search("jax|qutip", str(error)):
                raise
            continue
        for value in vars(imported).values():
            here = isinstance(value, type) and value.__module__ == module.name
            if here and dataclasses.is_dataclass(value):
                yield f"{module.name}.{value.__qualname__}", value


def test_dataclasses_are_frozen():
    relations = dict(classes())
    assert len(relations) > 60
    changing = {name for name, one in relations.items() if not one.__dataclass_params__.frozen}
    modules = {name for name in changing if name.startswith("cg.jax.")}  # equinox freezes them
    assert changing == modules

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
from fractions import Fraction

import numpy as np
import pytest
from frame_examples import FRAMES

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


def turning(t, y, *numbers):
    return [0.3, -0.2 * np.cos(t), 0.1]


def event(t, y, *numbers):
    return t - 0.7


def results():
    """Yield what calls of integrators return, and what belongs to it."""
    line = {"frame": frames.SO3(), "rtol": 1e-3, "dense_output": True, "events": event}
    one, many = (turning, (0.0, 1.0), np.eye(3)), (turning, (0.0, 1.0), np.stack([np.eye(3)] * 2))
    yield cg.solve_ivp(*one, **line)
    yield cg.solve_linear(lambda t: turning(t, None), *one[1:], **line)
    yield cg.solve_ensemble(*many, **line)
    yield cg.solve_ivp(*one, frame=frames.SO3(), derivatives="forward", P0=np.eye(3))
    yield cg.solve_ivp(*one, frame=frames.SO3(), derivatives="adjoint")
    yield cg.solve_ensemble(*many, frame=frames.SO3(), derivatives="forward")
    yield cg.Stepper(turning, 0.0, np.eye(3), 1.0, frame=frames.SO3())


def examples():
    """Yield objects by name, of all public classes."""
    for kind in (cg.Tableau, cg.CommutatorFree, cg.MuntheKaas, cg.MagnusMethod, cg.Splitting):
        yield next((name, m) for name, m in cg.methods.items() if isinstance(m, kind))
    libm = ctypes.util.find_library("m")
    more = [
        *results(), cg.CompiledFunction(libm, "nextafter", [1.0, 2.0]), cg.Structure.MIDDLE,
        problems.FreeRigidBody().reference([1]), cg.Event(abs, terminal=2),
        cg.Langevin(1.0, 0.7, seed=1),
        frames.Joint("ball", (0, [0.0, 0.0, 1.0]), (None, [0.0, 0.0, 0.0])),
        cg.Samples([0.0, 0.5, 1.0], [[1.0, 2.0, 3.0]], kind="hold", members=True),
        cg.certify("CG3"), cg.diagnose("CG3", c=[0, Fraction(3, 4), Fraction(17, 24)]),
        cg.lift(cg.methods["CG3"], 3, tries=2), problems.FreeRigidBody(), problems.HeavyTop(),
        problems.StateDependentRotation(), frames.LinearAction([[[0.0, 1.0], [-1.0, 0.0]]]),
        frames.PhaseSpace(frames.SO3()), frames.FieldFrame([np.ones_like], np.add, point_shape=1),
        *(frame for frame in FRAMES if copied_by_name(frame)),
    ]  # fmt: skip
    for i, each in enumerate(more):
        yield f"{type(each).__name__} {i}", each
        for part in ("sol", "adjoint"):
            if getattr(each, part, None) is not None:
                yield f"{part} of {type(each).__name__} {i}", getattr(each, part)


def copied_by_name(frame):
    """Return whether a frame has no functions without names."""
    return not isinstance(frame, frames.FieldFrame | frames.MatrixFrame) or "lambda" not in str(
        vars(frame)
    )


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

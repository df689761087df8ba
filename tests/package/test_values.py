"""Records of the package are immutable, so that they can be shared and hashed."""

import dataclasses
import importlib
import pkgutil

import cg


def classes():
    for module in pkgutil.walk_packages(cg.__path__, "cg."):
        if module.name.endswith("__main__"):
            continue
        try:
            imported = importlib.import_module(module.name)
        except ImportError as error:
            if "jax" in str(error) or error.name == "qutip":
                continue
            raise
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

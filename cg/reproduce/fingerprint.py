"""Digests of code and data, by which results of other versions are recognised."""

from __future__ import annotations

import ast
import hashlib
import json
import re
import sys
from collections.abc import Container, Iterable, Mapping
from functools import cache
from importlib.resources import files
from importlib.util import find_spec, resolve_name
from pathlib import Path
from typing import Any

from cg.proofs.files import folder as certificate_folder

__all__ = ["of_code", "of_package", "sources"]

_COMPILED = re.compile(r"cg\._\w+")


def of_code(module: str, arguments: Mapping[str, Any]) -> str:
    """Return a digest of arguments and of all code that the results of a module depend on.

    Parameters
    ----------
    module : str
        Full name of the module.
    arguments : mapping
        Values that JSON can represent.
    """
    modules = sources(module)
    parts = [json.dumps(arguments, sort_keys=True).encode(), *_data(modules)]
    return _digest(parts, modules.values())


@cache
def sources(module: str) -> Mapping[str, Path]:
    """Return the files of a module and of all modules of ``cg`` that it imports, by name.

    Imports within functions are included, and strings that name a compiled module. The package
    ``cg`` itself, which imports everything, is not.
    """
    modules: dict[str, Path] = {}
    pending = [module]
    while pending:
        name = pending.pop()
        spec = _spec(name)
        if name in modules or spec is None or spec.origin is None:
            continue
        path = modules[name] = Path(spec.origin)
        if path.suffix == ".py":
            package = name if path.name == "__init__.py" else name.rpartition(".")[0]
            pending += _imported(path, package)
    return dict(sorted(modules.items()))


def _spec(name: str) -> Any:
    try:
        return find_spec(name)
    except ModuleNotFoundError:  # the name of a function or class in a module
        return None


def _imported(path: Path, package: str) -> Iterable[str]:
    """Yield imported names that may be modules of ``cg``."""
    for node in ast.walk(ast.parse(path.read_bytes())):
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            origin = resolve_name("." * node.level + (node.module or ""), package)
            names = [origin, *(f"{origin}.{alias.name}" for alias in node.names)]
        elif isinstance(node, ast.Constant) and isinstance(node.value, str):
            names = [node.value] if _COMPILED.fullmatch(node.value) else []  # for import_module
        else:
            continue
        yield from (name for name in names if name.startswith("cg."))


def of_package() -> str:
    """Return a digest of all loaded modules of the package, and of its data."""
    modules = {
        Path(str(module.__file__))
        for name, module in sys.modules.items()
        if name.partition(".")[0] == "cg" and getattr(module, "__file__", None)
    }
    return _digest(_data(sys.modules), sorted(modules, key=lambda path: path.name))


def _data(modules: Container[str]) -> list[bytes]:
    """Return the data files of modules: methods, certificates, the paper's numbers."""
    folders = {
        "cg.catalogue": files("cg.catalogue"),
        "cg.proofs.files": certificate_folder(),
        "cg.reproduce.appendix_a": files("cg.reproduce"),
    }
    return [
        path.read_bytes()
        for reader, folder in folders.items()
        if reader in modules
        for path in sorted(folder.iterdir(), key=lambda path: path.name)
        if path.name.endswith(".toml")
    ]


def _digest(parts: Iterable[bytes], paths: Iterable[Path]) -> str:
    total = hashlib.sha256()
    for part in (*parts, *(path.read_bytes() for path in paths)):
        total.update(hashlib.sha256(part).digest())
    return total.hexdigest()[:16]

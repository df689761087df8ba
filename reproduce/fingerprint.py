"""Digests of the code that made a number, so that none is taken for another version's."""

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
    """Return a digest of arguments and of all code that a module's results depend on.

    Parameters
    ----------
    module : str
        Its full name.
    arguments : mapping
        What JSON can hold.
    """
    found = sources(module)
    parts = [json.dumps(arguments, sort_keys=True).encode(), *_data(found)]
    return _digest(parts, found.values())


@cache
def sources(module: str) -> Mapping[str, Path]:
    """Return the files of a module and of all modules of ``cg`` that it imports, by name.

    Imports within functions count, and texts that name a compiled module; the package ``cg``
    itself, which imports everything, doesn't.
    """
    found: dict[str, Path] = {}
    pending = [module]
    while pending:
        name = pending.pop()
        spec = _spec(name)
        if name in found or spec is None or spec.origin is None:
            continue
        path = found[name] = Path(spec.origin)
        if path.suffix == ".py":
            package = name if path.name == "__init__.py" else name.rpartition(".")[0]
            pending += _imported(path, package)
    return dict(sorted(found.items()))


def _spec(name: str) -> Any:
    try:
        return find_spec(name)
    except ModuleNotFoundError:  # what is imported from a module, such as a function
        return None


def _imported(path: Path, package: str) -> Iterable[str]:
    """Yield names that may be modules of ``cg`` and that a file imports."""
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
    """Return a digest of all modules of the package that are loaded, and of its data."""
    modules = {
        Path(str(module.__file__))
        for name, module in sys.modules.items()
        if name.partition(".")[0] == "cg" and getattr(module, "__file__", None)
    }
    return _digest(_data(sys.modules), sorted(modules, key=lambda path: path.name))


def _data(modules: Container[str]) -> list[bytes]:
    """Return the data that modules read: methods, certificates, the paper's numbers."""
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

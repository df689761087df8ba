"""Digests of the code that made a number, so that none is taken for another version's."""

from __future__ import annotations

import hashlib
import json
import sys
from collections.abc import Iterable, Mapping
from importlib import import_module
from importlib.resources import files
from pathlib import Path
from typing import Any

from cg.certification.files import folder as certificate_folder

__all__ = ["of_package", "of_search"]

# by name, since the package has a function of the same name as one of them
_SEARCH = (
    "cg._core_r64",
    "cg._core_r128",
    "cg.random_search",
    "cg.condition_counts",
    "cg.conditions",
    "cg.oracle",
    "cg.quad",
    "cg.search_records",
)


def of_search(arguments: Mapping[str, Any]) -> str:
    """Return a digest of a search's arguments and of all code that its results depend on."""
    modules = map(import_module, _SEARCH)
    return _digest(
        [json.dumps(arguments, sort_keys=True).encode()],
        (Path(str(module.__file__)) for module in modules),
    )


def of_package() -> str:
    """Return a digest of all modules of the package that are loaded, and of its data."""
    modules = {
        Path(str(module.__file__))
        for name, module in sys.modules.items()
        if name.partition(".")[0] == "cg" and getattr(module, "__file__", None)
    }
    folders = (files("cg.catalogue"), certificate_folder(), files("cg.reproduce"))
    data = [
        path.read_bytes()
        for folder in folders
        for path in sorted(folder.iterdir(), key=lambda path: path.name)
        if path.name.endswith(".toml")
    ]
    return _digest(data, sorted(modules, key=lambda path: path.name))


def _digest(parts: Iterable[bytes], paths: Iterable[Path]) -> str:
    total = hashlib.sha256()
    for part in (*parts, *(path.read_bytes() for path in paths)):
        total.update(hashlib.sha256(part).digest())
    return total.hexdigest()[:16]

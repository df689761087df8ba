"""A digest of the package, by which results of other versions are recognised."""

import hashlib
import json
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import cg

_COMPILED = ("cg._core_r64", "cg._core_r128")


def digest(**arguments: Any) -> str:
    """Return a digest of arguments, which JSON can represent, and of all files of the package."""
    text = json.dumps(arguments, sort_keys=True) + package_digest()
    return hashlib.sha256(text.encode()).hexdigest()[:16]


@cache
def package_digest() -> str:
    """Return a digest of the modules, compiled modules and data of the package."""
    folder = Path(cg.__file__).parent
    paths = [path for path in folder.rglob("*") if path.suffix in (".py", ".toml", ".css")]
    # an editable installation has them in another folder
    paths += [Path(spec.origin) for name in _COMPILED if (spec := find_spec(name)) and spec.origin]
    total = hashlib.sha256()
    for path in sorted(paths, key=lambda path: (path.name, path)):
        total.update(hashlib.sha256(path.read_bytes()).digest())
    return total.hexdigest()

"""The catalogue of methods, with one TOML file for each method.

The file of a tableau has the keys ``name``, ``source``, ``a`` (rows as for `cg.Tableau`), ``b``
and, for pairs, ``b_embedded``. The file of a commutator-free method has instead of ``a`` and ``b``
the keys ``points`` (tables with ``parent``, -1 for the initial point, and ``weights`` by stage,
from 0), ``stage_points``, ``result`` and, for pairs, ``embedded_result``. Coefficients are strings
with all their digits; TOML numbers are read as strings as well. A method that satisfies its order
conditions only approximately has a table ``nominal`` with the intended ``order`` and an upper bound
``residual`` of its residuals. A tableau with ``kind = "Munthe-Kaas"`` is a Munthe-Kaas method and
may have ``b_third``. A file with ``kind = "Magnus"`` has ``nodes``, ``weights``, if it needs them
``brackets`` and, for pairs, ``embedded`` and ``b_third``, as for `cg.MagnusMethod`; with ``kind =
"splitting"`` it has ``drifts`` and ``kicks``, as for `cg.Splitting`.
"""

from __future__ import annotations

import json
from collections.abc import Hashable, Iterator, Mapping
from functools import cache, cached_property
from importlib.resources import files
from importlib.resources.abc import Traversable
from os import PathLike
from pathlib import Path
from typing import Any

from cg.construction.catalogue.entries import dumps, dumps_json, is_file, load, loads, read, save
from cg.construction.methods.magnus import LOBATTO, MagnusMethod, lobatto
from cg.construction.methods.method import Method
from cg.construction.points import MethodError
from cg.support import checks

__all__ = [
    "Catalogue",
    "dumps",
    "dumps_json",
    "find_method",
    "is_file",
    "load",
    "loads",
    "methods",
    "resolve_method",
    "save",
    "similar_names",
]


class Catalogue(Mapping[str, Method]):
    """An immutable mapping from names to methods; a file is read at the first access.

    Orders are those in the folder's ``summaries.json``, since to compute them takes longer than
    most integrations. They are computed for methods that aren't in it.

    Parameters
    ----------
    folder
        Contains a TOML file for each method, with the name of the method.

    Examples
    --------
    >>> import crouch_grossman as cg
    >>> cg.methods["CG4a"]
    <Tableau CG4a: order 4, 5 evaluations, 15 flows>
    >>> [name for name in cg.methods if name.startswith("CG4")]
    ['CG4(3)', 'CG4(3)b', 'CG4', 'CG4a', 'CG4b', 'CG4c']
    >>> "RK4" in cg.methods
    False
    """

    def __init__(self, folder: Traversable) -> None:
        self._files = {
            path.name.removesuffix(".toml"): path
            for path in sorted(folder.iterdir(), key=lambda path: path.name)
            if path.name.endswith(".toml")
        }
        self._folder = folder
        self._loaded: dict[str, Method] = {}

    @cached_property
    def summaries(self) -> dict[str, dict[str, Any]]:
        """Stored fields of `summary.MethodSummary`, by name of the method."""
        file = self._folder / "summaries.json"
        entries = json.loads(file.read_text(encoding="utf-8")) if file.is_file() else []
        return {entry["name"]: entry for entry in entries}

    def __getitem__(self, name: str) -> Method:
        if not isinstance(name, Hashable) or isinstance(name, slice):
            raise TypeError(f"the name of a method must be a str, got {name!r}")
        if name not in self._files:
            raise KeyError(f"no method is named {name!r}{similar_names(name)}; {_ALL}")
        if name not in self._loaded:
            method = self.read_again(name)
            if (stored := self.summaries.get(name)) is not None:
                method.use_stored(stored["order"], stored["embedded_order"])
            self._loaded[name] = method
        return self._loaded[name]

    def read_again(self, name: str) -> Method:
        """Return a new object of a method, which computes its orders itself."""
        method = read(self._files[name])
        if method.name != name:
            raise MethodError(f"{self._files[name]}: name must be {name!r}, got {method.name!r}")
        return method

    def __contains__(self, name: object) -> bool:
        return isinstance(name, str) and name in self._files

    def __iter__(self) -> Iterator[str]:
        return iter(self._files)

    def __len__(self) -> int:
        return len(self._files)

    def _ipython_key_completions_(self) -> list[str]:
        return list(self)

    def __repr__(self) -> str:
        return f"<Catalogue: {', '.join(self._files)}>"


methods = Catalogue(files(__name__))
"""All methods, by name."""

_LOBATTO_NODES = 9  # nodes on LinearAction; more save few evaluations and no products
_STIFF = "RadauIIA5 is the one here for stiff equations"
_ELSEWHERE = {
    "RK45": "SciPy has a method of that name; DP5(4) has its coefficients",
    "RK23": "SciPy has a method of that name; BS3(2) has its coefficients",
    "Tsit5": "diffrax has a method of that name; RKMK5(4) and CF5(4) have its orders",
    "Dopri5": "diffrax has a method of that name; RKMK5(4) and DP5(4) have its coefficients",
    "Verlet": "Leapfrog is the method of Störmer and Verlet",
    "Yoshida6": "BlanesMoan6 is the splitting method of its order here",
    "Dopri8": "diffrax has a method of that name; RKMK8(5,3) has its order",
} | dict.fromkeys(("Radau", "BDF", "LSODA"), f"SciPy has a method of that name; {_STIFF}")
_ALL = "all names are in list(cg.methods)"


def find_method(name: str) -> Method | None:
    """Return the method with a name, None without one, faster than `methods.get` does."""
    if name not in methods:
        return None
    return methods[name]


def method_of(name: str) -> Method:
    """Return the method of a stored table."""
    return _lobatto() if name == LOBATTO else methods[name]


def stored_methods() -> list[Method]:
    """Return the methods whose tables are stored: those of the catalogue, and an unlisted one."""
    return [*methods.values(), _lobatto()]


@cache
def _lobatto() -> MagnusMethod:
    return lobatto(_LOBATTO_NODES)


def similar_names(name: object) -> str:
    """Return a part of an error message: the names most similar to `name`, after a semicolon."""
    if not isinstance(name, str):
        return ""
    if name in _ELSEWHERE:
        return f"; {_ELSEWHERE[name]}"
    linear = name.upper().startswith("CFM")  # no others are for linear equations alone
    return checks.similar_names(
        name, (n for n, m in methods.items() if linear or not isinstance(m, MagnusMethod))
    )


def resolve_method(method: str | PathLike[str] | Method) -> Method:
    """Return a method given as such, by its name in the catalogue, or as a TOML or JSON file."""
    if isinstance(method, Method):
        return method
    if isinstance(method, PathLike) or (isinstance(method, str) and is_file(method)):
        if not Path(method).exists():
            raise FileNotFoundError(f"method must be a name or an existing file, got {method!r}")
        return load(method)
    if not isinstance(method, str):
        hint = similar_names(getattr(method, "__name__", None))
        raise TypeError(f"method must be a name, a path, or a Method, got {method!r}{hint}")
    if (stored := find_method(method)) is not None:
        return stored
    hint = similar_names(method) or f"; {_ALL}"
    raise ValueError(f"method must be the name of a method, got {method!r}{hint}")

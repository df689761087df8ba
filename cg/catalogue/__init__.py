"""The catalogue of methods: one TOML file each.

The file of a tableau has the keys ``name``, ``source``, ``a`` (rows, as `cg.Tableau` takes
them), ``b`` and, for pairs, ``b_embedded``. That of a commutator-free method has ``points`` in
their place (tables with ``parent``, -1 for the initial point, and ``weights`` by stage, from 0),
``stage_points``, ``result`` and, for pairs, ``embedded_result``. Coefficients are strings, so
that all their digits are kept; bare TOML numbers are read digit by digit as well. A method that
satisfies its order conditions only approximately has a table ``nominal`` with the ``order`` that
is meant and the ``residual`` that no condition through it exceeds. ``kind = "Munthe-Kaas"`` makes
a tableau one of a Lie algebra; it may have ``b_third`` then. Those that come with this package are
in a folder of their own: their orders are those of vector spaces.
"""

from __future__ import annotations

from collections.abc import Hashable, Iterator, Mapping
from difflib import get_close_matches
from importlib.resources import files
from importlib.resources.abc import Traversable

from ..method import Method
from ..points import MethodError
from .entries import dumps, dumps_json, load, loads, read, save

__all__ = [
    "Catalogue",
    "dumps",
    "dumps_json",
    "load",
    "loads",
    "methods",
    "munthe_kaas",
    "resolve_method",
    "save",
]


class Catalogue(Mapping[str, Method]):
    """An immutable mapping from names to methods; a file is read when first asked for.

    Parameters
    ----------
    folder : Traversable
        Holds one TOML file a method, named like it.
    """

    def __init__(self, folder: Traversable) -> None:
        self._files = {
            path.name.removesuffix(".toml"): path
            for path in sorted(folder.iterdir(), key=lambda path: path.name)
            if path.name.endswith(".toml")
        }
        self._loaded: dict[str, Method] = {}

    def __getitem__(self, name: str) -> Method:
        if not isinstance(name, Hashable):
            raise TypeError(f"the name of a method must be a str, got {name!r}")
        if name not in self._files:
            known = ", ".join(self._files)
            there = "; cg.catalogue.munthe_kaas has it" if name in munthe_kaas else ""
            raise KeyError(f"no method is named {name!r}{there}; the catalogue has {known}")
        if name not in self._loaded:
            method = read(self._files[name])
            if method.name != name:
                raise MethodError(f"{self._files[name]}: the name inside is {method.name!r}")
            self._loaded[name] = method
        return self._loaded[name]

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
"""The methods that come with this package, by name."""

munthe_kaas = Catalogue(files(__name__) / "munthe_kaas")
"""Those of Runge, Kutta and Munthe-Kaas, by name."""


def resolve_method(method: str | Method) -> Method:
    """Return the method that `method` is or names.

    Parameters
    ----------
    method
        A method, or the name of one in the catalogue.

    Raises
    ------
    ValueError
        If no method of the catalogue has that name; the message lists those there are, and says
        which are near it.
    TypeError
        If `method` is neither a name nor a method.
    """
    if isinstance(method, Method):
        return method
    if not isinstance(method, str):
        raise TypeError(f"method must be a name or a Method, got {method!r}")
    if method in munthe_kaas:
        return munthe_kaas[method]
    if method not in methods:
        known = [*methods, *munthe_kaas]
        near = get_close_matches(method.upper(), known, n=3, cutoff=0.5)
        hint = f"; near it are {', '.join(near)}" if near else ""
        raise ValueError(f"method must be one of {', '.join(known)}, got {method!r}{hint}")
    return methods[method]

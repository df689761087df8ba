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

from ..method.method import Method
from ..structure.points import MethodError
from .entries import dumps, dumps_json, load, loads, read, save
from .own import OwnMethods, own_folders

__all__ = [
    "Catalogue",
    "Methods",
    "dumps",
    "dumps_json",
    "load",
    "loads",
    "magnus",
    "methods",
    "munthe_kaas",
    "near",
    "own_folders",
    "packaged",
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
            raise KeyError(f"no method is named {name!r}; there are {', '.join(self._files)}")
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


class Methods(Mapping[str, Method]):
    """The methods of this package, and those in the folders of the user, by name.

    Attributes
    ----------
    own : Mapping
        Those of the user; see `cg.catalogue.own.own_folders`.

    Examples
    --------
    >>> import cg
    >>> cg.methods["CG4a"]
    <Tableau CG4a: order 4, 5 evaluations, 15 flows>
    >>> [name for name in cg.methods if name.startswith("CG4")]
    ['CG4(3)', 'CG4(3)b', 'CG4', 'CG4a', 'CG4b', 'CG4c']
    >>> "RK4" in cg.methods
    False
    """

    def __init__(self, package: Catalogue, own: OwnMethods) -> None:
        self._package = package
        self.own = own

    def __getitem__(self, name: str) -> Method:
        if not isinstance(name, Hashable):
            raise TypeError(f"the name of a method must be a str, got {name!r}")
        if name in self._package:
            return self._package[name]
        if name in self.own:
            return self.own[name]
        if isinstance(name, str) and (problem := self.own.problem(name)):
            raise MethodError(problem)
        there = "; cg.catalogue.munthe_kaas has it" if name in munthe_kaas else ""
        hint = "" if there else near(name)
        known = ", ".join(self)
        raise KeyError(f"no method is named {name!r}{there}; the catalogue has {known}{hint}")

    def __contains__(self, name: object) -> bool:
        return isinstance(name, str) and (name in self._package or name in self.own)

    def __iter__(self) -> Iterator[str]:
        yield from self._package
        yield from self.own

    def __len__(self) -> int:
        return len(self._package) + len(self.own)

    def _ipython_key_completions_(self) -> list[str]:
        return list(self)

    def __repr__(self) -> str:
        return f"<Catalogue: {', '.join(self)}>"


packaged = Catalogue(files(__name__))
"""The methods that come with this package, by name."""

munthe_kaas = Catalogue(files(__name__) / "munthe_kaas")
"""Those of Runge, Kutta and Munthe-Kaas, by name."""

magnus = Catalogue(files(__name__) / "magnus")
"""Commutator-free Magnus methods, for linear equations, by name."""

_STIFF = "of the pairs here DICG3(2) is for stiff equations"
_IN_SCIPY = {
    "RK45": "SciPy has a method of that name; DP5(4) has its coefficients",
    "RK23": "SciPy has a method of that name; BS3(2) has its coefficients",
} | dict.fromkeys(("Radau", "BDF", "LSODA"), f"SciPy has a method of that name; {_STIFF}")

methods = Methods(packaged, OwnMethods(lambda name: name in packaged or name in munthe_kaas))
"""`packaged`, and the methods of the user, by name."""


def near(name: object) -> str:
    """Return what may be meant by a name that no method has, to end an error message with."""
    if not isinstance(name, str):
        return ""
    if name in _IN_SCIPY:
        return f"; {_IN_SCIPY[name]}"
    known = {given.upper(): given for given in (*methods, *munthe_kaas)}
    found = [known[key] for key in get_close_matches(name.upper(), known, n=3, cutoff=0.5)]
    return f"; near it are {', '.join(found)}" if found else ""


def resolve_method(method: str | Method) -> Method:
    """Return the method that `method` is or names.

    Parameters
    ----------
    method
        A method, or the name of one in the catalogue or in a folder of the user.

    Raises
    ------
    ValueError
        If no method has that name; the message lists those there are, and says which are near
        it. Or if the user's file of that name holds none.
    TypeError
        If `method` is neither a name nor a method.
    """
    if isinstance(method, Method):
        return method
    if not isinstance(method, str):
        raise TypeError(f"method must be a name or a Method, got {method!r}")
    for catalogue in (packaged, munthe_kaas, methods.own):
        if method in catalogue:
            return catalogue[method]
    if problem := methods.own.problem(method):
        raise ValueError(f"method {method!r} can't be used: {problem}")
    known = ", ".join([*methods, *munthe_kaas])
    raise ValueError(f"method must be one of {known}, got {method!r}{near(method)}")

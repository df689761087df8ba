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

import json
import re
from collections.abc import Hashable, Iterator, Mapping, Sequence
from difflib import get_close_matches
from importlib.resources import files
from importlib.resources.abc import Traversable
from os import PathLike
from pathlib import Path
from typing import Any

from ..coefficients import Coefficient
from ..commutator_free import CommutatorFree
from ..method import Method
from ..munthe_kaas import MuntheKaas
from ..points import MethodError
from ..tableau import Tableau, TableauError
from ..texts import file_in, read_toml

__all__ = [
    "Catalogue",
    "dumps",
    "load",
    "loads",
    "methods",
    "munthe_kaas",
    "resolve_method",
    "save",
]

_REQUIRED = {"name", "source", "a", "b"}
_OPTIONAL = {"b_embedded", "nominal"}
_OPTIONAL_OF_ALGEBRAS = {"kind", "b_embedded", "b_third"}
_KIND = "Munthe-Kaas"
_REQUIRED_OF_POINTS = {"name", "source", "points", "stage_points", "result"}
_OPTIONAL_OF_POINTS = {"embedded_result", "b_third", "nominal"}
_POINT = {"parent", "weights"}
_NOMINAL = {"order", "residual"}
_STAGE = re.compile(r"\d{1,6}", re.ASCII)


def loads(text: str) -> Method:
    """Read a method from the text of a catalogue file.

    Raises
    ------
    MethodError
        If the text isn't TOML, a key is missing or unknown, or the method is wrong; of
        tableaux a `TableauError`.
    """
    if not isinstance(text, str):
        raise TypeError(f"text must be a str, got {text!r}")
    entry = read_toml(text, TableauError, parse_float=str)
    points = "points" in entry
    if "kind" in entry:
        return _read_munthe_kaas(entry)
    if points:
        _check_keys(entry, _REQUIRED_OF_POINTS, _OPTIONAL_OF_POINTS, "the entry")
    else:
        _check_keys(entry, _REQUIRED, _OPTIONAL, "the entry")
    nominal: dict[str, Any] = {}
    if "nominal" in entry:
        table = entry.pop("nominal")
        if not isinstance(table, dict):
            raise TableauError(f"nominal must be a table, got {table!r}")
        _check_keys(table, _NOMINAL, set(), "nominal")
        nominal = {f"nominal_{key}": value for key, value in table.items()}
    if points:
        third = entry.pop("b_third", None)
        return CommutatorFree(_read_points(entry.pop("points")), third=third, **entry, **nominal)
    return Tableau(entry.pop("a"), entry.pop("b"), **entry, **nominal)


def _read_munthe_kaas(entry: dict[str, Any]) -> MuntheKaas:
    _check_keys(entry, _REQUIRED, _OPTIONAL_OF_ALGEBRAS, "the entry")
    if (kind := entry.pop("kind")) != _KIND:
        raise MethodError(f"kind must be {_KIND!r}, got {kind!r}")
    third = entry.pop("b_third", None)
    return MuntheKaas(Tableau(entry.pop("a"), entry.pop("b"), **entry), third=third)


def _read_points(tables: Any) -> list[Any]:
    if not isinstance(tables, list):
        raise MethodError(f"points must be an array of tables, got {tables!r}")
    points = []
    for m, table in enumerate(tables):
        if not isinstance(table, dict) or not isinstance(table.get("weights", {}), dict):
            raise MethodError(f"point {m} must be a table with one of weights, got {table!r}")
        _check_keys(table, _POINT, set(), f"point {m}")
        stages = table["weights"]
        if wrong := [stage for stage in stages if not _STAGE.fullmatch(stage)]:
            raise MethodError(f"weights of point {m} must be on stages, got one on {wrong[0]!r}")
        points.append((table["parent"], {int(k): weight for k, weight in stages.items()}))
    return points


def _check_keys(table: dict[str, Any], required: set[str], optional: set[str], where: str) -> None:
    if missing := sorted(required - set(table)):
        raise TableauError(f"{where} lacks {', '.join(missing)}")
    if unknown := sorted(set(table) - required - optional):
        raise TableauError(f"{where} has unknown keys: {', '.join(unknown)}")


def load(path: str | PathLike[str]) -> Method:
    """Read a method from a catalogue file.

    Raises
    ------
    TypeError
        If `path` isn't one.
    MethodError
        As for `loads`; the message names the file.
    OSError
        If the file can't be read.
    """
    return _load(_path(path))


def _path(path: str | PathLike[str]) -> Path:
    if not isinstance(path, str | PathLike):
        raise TypeError(f"path must be a path, got {path!r}")
    return Path(path)


def _load(path: Traversable) -> Method:
    try:
        return loads(path.read_text(encoding="utf-8"))
    except UnicodeDecodeError as error:
        raise TableauError(f"{path}: not UTF-8: {error}") from None
    except MethodError as error:
        raise type(error)(f"{path}: {error}") from None


def dumps(method: Method) -> str:
    """Write a method as the text of a catalogue file; `loads` gives an equal one back."""
    lines = []
    if isinstance(method, Tableau | MuntheKaas):
        rows = method.layout.cut(method.coefficients)
        lines += ["a = [", *(f"  {_array(row)}," for row in rows[: method.stages]), "]"]
        for label, row in zip(("b", "b_embedded"), rows[method.stages :], strict=False):
            lines.append(f"{label} = {_array(row)}")
        if isinstance(method, MuntheKaas):
            lines.insert(0, f"kind = {_quoted(_KIND)}")
    elif isinstance(method, CommutatorFree):
        lines.append("points = [")
        for point, weights in zip(method.points, method.point_coefficients, strict=True):
            texts = ", ".join(f"{stage} = {_quoted(w.text)}" for stage, w in weights.items())
            lines.append(f"  {{parent = {point.parent}, weights = {{{texts}}}}},")
        lines += ["]", f"stage_points = {list(method.stage_points)}", f"result = {method.result}"]
        if method.embedded_result is not None:
            lines.append(f"embedded_result = {method.embedded_result}")
    else:
        raise TypeError(f"method must be a Tableau, CommutatorFree or MuntheKaas, got {method!r}")
    if isinstance(method, CommutatorFree | MuntheKaas) and method.third_weights is not None:
        lines.append(f"b_third = {_array(method.third_weights)}")
    if method.nominal_residual is not None:
        lines += ["", "[nominal]", f"order = {method.nominal_order}"]
        lines.append(f"residual = {_quoted(method.nominal_residual.text)}")
    head = [f"name = {_quoted(method.name)}", f"source = {_quoted(method.source)}"]
    return "\n".join([*head, *lines]) + "\n"


def _array(row: Sequence[Coefficient]) -> str:
    return "[" + ", ".join(_quoted(coefficient.text) for coefficient in row) + "]"


def _quoted(text: str) -> str:
    # JSON's escapes are TOML's, except that TOML wants this one escaped too
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")


def save(method: Method, path: str | PathLike[str]) -> None:
    """Write a method to a catalogue file.

    Parameters
    ----------
    method : Method
    path : path
        Of the file, or a folder that gets a file named like the method.

    Raises
    ------
    ValueError
        If it is a folder and the name isn't fit for a file's name.
    OSError
        If the file can't be written.
    """
    text, path = dumps(method), _path(path)
    if path.is_dir():
        path = file_in(path, method.name)
    path.write_text(text, encoding="utf-8")


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
            method = _load(self._files[name])
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

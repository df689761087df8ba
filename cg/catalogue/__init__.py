"""The catalogue of methods: one TOML file each.

A file has the keys ``name``, ``source``, ``a`` (rows, as `cg.Tableau` takes them), ``b``
and, for pairs, ``b_embedded``. Coefficients are strings, so that all their digits are
kept; bare TOML numbers are read digit by digit as well. A method that satisfies its order
conditions only approximately has a table ``nominal`` with the ``order`` that is meant and
the ``residual`` that no condition through it exceeds.
"""

from __future__ import annotations

import json
import tomllib
from collections.abc import Hashable, Iterator, Mapping, Sequence
from importlib.resources import files
from importlib.resources.abc import Traversable
from os import PathLike
from pathlib import Path
from typing import Any

from ..coefficients import Coefficient
from ..conditions import row_lengths
from ..tableau import Tableau, TableauError

__all__ = ["Catalogue", "dumps", "load", "loads", "methods", "save"]

_REQUIRED = {"name", "source", "a", "b"}
_OPTIONAL = {"b_embedded", "nominal"}
_NOMINAL = {"order", "residual"}


def loads(text: str) -> Tableau:
    """Read a method from the text of a catalogue file.

    Raises
    ------
    TableauError
        If the text isn't TOML, a key is missing or unknown, or the tableau is wrong.
    """
    if not isinstance(text, str):
        raise TypeError(f"text must be a str, got {text!r}")
    try:
        entry = tomllib.loads(text, parse_float=str)
    except tomllib.TOMLDecodeError as error:
        raise TableauError(f"not a TOML file: {error}") from None
    _check_keys(entry, _REQUIRED, _OPTIONAL, "the entry")
    nominal: dict[str, Any] = {}
    if "nominal" in entry:
        table = entry.pop("nominal")
        if not isinstance(table, dict):
            raise TableauError(f"nominal must be a table, got {table!r}")
        _check_keys(table, _NOMINAL, set(), "nominal")
        nominal = {f"nominal_{key}": value for key, value in table.items()}
    return Tableau(entry.pop("a"), entry.pop("b"), **entry, **nominal)


def _check_keys(table: dict[str, Any], required: set[str], optional: set[str], where: str) -> None:
    if missing := sorted(required - set(table)):
        raise TableauError(f"{where} lacks {', '.join(missing)}")
    if unknown := sorted(set(table) - required - optional):
        raise TableauError(f"{where} has unknown keys: {', '.join(unknown)}")


def load(path: str | PathLike[str]) -> Tableau:
    """Read a method from a catalogue file.

    Raises
    ------
    TypeError
        If `path` isn't one.
    TableauError
        As for `loads`; the message names the file.
    OSError
        If the file can't be read.
    """
    return _load(_path(path))


def _path(path: str | PathLike[str]) -> Path:
    if not isinstance(path, str | PathLike):
        raise TypeError(f"path must be a path, got {path!r}")
    return Path(path)


def _load(path: Traversable) -> Tableau:
    try:
        return loads(path.read_text(encoding="utf-8"))
    except UnicodeDecodeError as error:
        raise TableauError(f"{path}: not UTF-8: {error}") from None
    except TableauError as error:
        raise TableauError(f"{path}: {error}") from None


def dumps(method: Tableau) -> str:
    """Write a method as the text of a catalogue file; `loads` gives an equal one back."""
    if not isinstance(method, Tableau):
        raise TypeError(f"method must be a Tableau, got {method!r}")
    lengths = row_lengths(method.stages, method.rows)
    lines = [f"name = {_quoted(method.name)}", f"source = {_quoted(method.source)}", "a = ["]
    for row, length in zip(method.entries, lengths, strict=False):
        lines.append(f"  {_array(row[:length])},")
    lines += ["]", f"b = {_array(method.weights)}"]
    if method.embedded_weights is not None:
        lines.append(f"b_embedded = {_array(method.embedded_weights)}")
    if method.nominal_residual is not None:
        lines += ["", "[nominal]", f"order = {method.nominal_order}"]
        lines.append(f"residual = {_quoted(method.nominal_residual.text)}")
    return "\n".join(lines) + "\n"


def _array(row: Sequence[Coefficient]) -> str:
    return "[" + ", ".join(_quoted(coefficient.text) for coefficient in row) + "]"


def _quoted(text: str) -> str:
    # JSON's escapes are TOML's, except that TOML wants this one escaped too
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")


def save(method: Tableau, path: str | PathLike[str]) -> None:
    """Write a method to a catalogue file."""
    text = dumps(method)
    _path(path).write_text(text, encoding="utf-8")


class Catalogue(Mapping[str, Tableau]):
    """An immutable mapping from names to tableaux; a file is read when first asked for.

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
        self._loaded: dict[str, Tableau] = {}

    def __getitem__(self, name: str) -> Tableau:
        if not isinstance(name, Hashable):
            raise TypeError(f"the name of a method must be a str, got {name!r}")
        if name not in self._files:
            known = ", ".join(self._files)
            raise KeyError(f"no method is named {name!r}; the catalogue has {known}")
        if name not in self._loaded:
            method = _load(self._files[name])
            if method.name != name:
                raise TableauError(f"{self._files[name]}: the name inside is {method.name!r}")
            self._loaded[name] = method
        return self._loaded[name]

    def __contains__(self, name: object) -> bool:
        return isinstance(name, str) and name in self._files

    def __iter__(self) -> Iterator[str]:
        return iter(self._files)

    def __len__(self) -> int:
        return len(self._files)

    def __repr__(self) -> str:
        return f"<Catalogue: {', '.join(self._files)}>"


methods = Catalogue(files(__name__))
"""The methods that come with this package, by name."""

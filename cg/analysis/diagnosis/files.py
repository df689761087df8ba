"""Diagnoses of files, which may hold what no method can."""

from __future__ import annotations

from dataclasses import replace
from os import PathLike
from pathlib import Path
from typing import Any

from ...catalogue import load
from ...catalogue.entries import check_keys
from ...method.method import Method
from ...method.munthe_kaas import MuntheKaas
from ...method.tableau import Tableau, TableauError
from ...structure.points import MethodError
from ...support.parsing import read_json, read_toml
from .diagnosis import Diagnosis, diagnose
from .findings import Finding

__all__ = ["diagnose_file", "diagnose_tableau"]

_KEYS = {"name", "source", "kind", "a", "b", "b_embedded", "c"}
"""Of a file that is more generous than one of the catalogue."""

_KEYS_OF_OTHERS = {"points", "stage_points", "result", "nominal", "b_third"}
"""Of files that must be like those of the catalogue."""


def diagnose_file(path: str | PathLike[str]) -> Diagnosis:
    """Find out what the method in a file really is.

    Parameters
    ----------
    path : path
        A file as `cg.catalogue.load` reads it. That of a tableau may also have ``c``, abscissae
        that rows of a must sum to, may lack ``name`` and ``source``, and may have second weights
        that equal the first, which no method can.

    Raises
    ------
    TypeError
        If `path` isn't one.
    MethodError
        If it isn't a file of a method; the message names it.
    OSError
        If the file can't be read.
    """
    if not isinstance(path, str | PathLike):
        raise TypeError(f"path must be a path, got {path!r}")
    path = Path(path)
    try:
        entry = _read(path.read_text(encoding="utf-8"))
    except UnicodeDecodeError as error:
        raise TableauError(f"{path}: not UTF-8: {error}") from None
    except MethodError as error:
        raise type(error)(f"{path}: {error}") from None
    if not _KEYS_OF_OTHERS.isdisjoint(entry):
        return diagnose(load(path))
    try:
        check_keys(entry, {"a", "b"}, _KEYS, "the entry")
        return diagnose_tableau({"name": path.stem} | entry)
    except MethodError as error:
        raise type(error)(f"{path}: {error}") from None


def _read(text: str) -> dict[str, Any]:
    if text.lstrip().startswith("{"):  # which no line of TOML begins with
        return read_json(text, TableauError)
    return read_toml(text, TableauError, parse_float=str)


def diagnose_tableau(entry: dict[str, Any]) -> Diagnosis:
    """Diagnose the tableau that an entry of a file is; see `diagnose_file`.

    Parameters
    ----------
    entry : dict
        With the keys ``a`` and ``b``, and if there are ``name``, ``source``, ``kind``,
        ``b_embedded``, ``c``.
    """
    entry = dict(entry)
    c = entry.pop("c", None)
    equal = False
    try:
        method = _method(**entry)
    except TableauError:
        if "b_embedded" not in entry or not _same(entry["b"], entry["b_embedded"]):
            raise
        equal = True
        entry.pop("b_embedded")
        method = _method(**entry)
    found = diagnose(method, c=c)
    if not equal:
        return found
    finding = Finding(
        "equal weights",
        "b_embedded is b: the difference of both results is zero, and estimates no error",
    )
    return replace(found, findings=(finding, *found.findings))


def _method(
    a: Any, b: Any, *, name: str, kind: str | None = None, source: str = "", **options: Any
) -> Method:
    tableau = Tableau(a, b, name=name, source=source, **options)
    if kind is None:
        return tableau
    if kind != "Munthe-Kaas":
        raise MethodError(f"kind must be 'Munthe-Kaas', got {kind!r}")
    return MuntheKaas(tableau)


def _same(b: Any, second: Any) -> bool:
    # read as the weights of methods of no stages but these, so that texts may differ
    stages = len(b) if isinstance(b, list) else 0
    zeros = [[0] * stages] * stages
    return Tableau(zeros, b).exact[1] == Tableau(zeros, second).exact[1]

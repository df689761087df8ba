"""Diagnosis of files, also of tableaux that `cg.Tableau` rejects."""

from __future__ import annotations

from dataclasses import replace
from os import PathLike
from pathlib import Path
from typing import Any

from ...catalogue import load
from ...catalogue.entries import check_keys, read_entry
from ...method.method import Method
from ...method.munthe_kaas import MuntheKaas
from ...method.tableau import Tableau, TableauError
from ...structure.points import MethodError
from .diagnosis import Diagnosis, diagnose
from .findings import Finding

_KEYS = {"name", "source", "kind", "a", "b", "b_embedded", "c"}
"""Keys of a file of a tableau; more than in the catalogue are optional."""

_KEYS_OF_OTHERS = {"points", "stage_points", "result", "nominal", "b_third"}
"""Keys of files in the format of the catalogue."""


def diagnose_file(path: str | PathLike[str]) -> Diagnosis:
    """Diagnose the method in a file.

    Parameters
    ----------
    path : path
        A file as `cg.catalogue.load` reads it. A file of a tableau may also have abscissae ``c``,
        may lack ``name`` and ``source``, and may have second weights equal to the first, which
        `cg.Tableau` rejects.

    Raises
    ------
    TypeError
        If `path` isn't a path.
    MethodError
        If the file doesn't define a method; the message names the file.
    OSError
        If the file can't be read.
    """
    if not isinstance(path, str | PathLike):
        raise TypeError(f"path must be a path, got {path!r}")
    path = Path(path)
    try:
        entry = read_entry(path.read_text(encoding="utf-8"))
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


def diagnose_tableau(entry: dict[str, Any]) -> Diagnosis:
    """Diagnose the tableau in an entry of a file; see `diagnose_file`.

    The entry has the keys ``a``, ``b`` and ``name``; ``source``, ``kind``, ``b_embedded`` and ``c``
    are optional.
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
    diagnosis = diagnose(method, c=c)
    if not equal:
        return diagnosis
    finding = Finding(
        "equal weights",
        "b_embedded equals b: the difference of the results is zero and estimates no error",
    )
    return replace(diagnosis, findings=(finding, *diagnosis.findings))


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
    # compare values, since texts such as 1/2 and 0.5 differ
    stages = len(b) if isinstance(b, list) else 0
    zeros = [[0] * stages] * stages
    return Tableau(zeros, b).exact[1] == Tableau(zeros, second).exact[1]

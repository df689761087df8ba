"""Diagnosis of files, also of tableaux that `cg.Tableau` rejects."""

from dataclasses import replace
from os import PathLike
from typing import Any

from cg.analysis.diagnosis.diagnosis import Diagnosis, diagnose
from cg.analysis.diagnosis.findings import Finding
from cg.catalogue.entries import check_path, errors_naming, from_entry, read_entry
from cg.method.tableau import Tableau, TableauError
from cg.support.parsing import read_file


def diagnose_file(path: str | PathLike[str]) -> Diagnosis:
    """Diagnose the method in a file; unlike `cg.load`, accept wrong ``c`` and equal weights."""
    path = check_path(path)
    with errors_naming(path):
        return diagnose_entry(read_entry(read_file(path, TableauError)), path.stem)


def diagnose_entry(entry: dict[str, Any], name: str = "") -> Diagnosis:
    """Diagnose the method in the keys and values of a file; see `diagnose_file`."""
    entry = dict(entry)
    c = entry.pop("c", None)
    equal = False
    try:
        method = from_entry(entry, name)
    except TableauError:
        if "b_embedded" not in entry or not _same(entry["b"], entry["b_embedded"]):
            raise
        equal = True
        entry.pop("b_embedded")
        method = from_entry(entry, name)
    diagnosis = diagnose(method, c=c)
    if not equal:
        return diagnosis
    finding = Finding(
        "equal weights",
        "b_embedded equals b: the difference of the results is zero and estimates no error",
    )
    return replace(diagnosis, findings=(finding, *diagnosis.findings))


def _same(b: Any, second: Any) -> bool:
    # compare values, since texts such as 1/2 and 0.5 differ
    stages = len(b) if isinstance(b, list) else 0
    zeros = [[0] * stages] * stages
    return Tableau(zeros, b).exact[1] == Tableau(zeros, second).exact[1]

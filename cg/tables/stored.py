"""Tables of methods by name, and of methods of the user."""

from __future__ import annotations

import gzip
import json
from functools import cache, lru_cache
from importlib import import_module
from importlib.resources import files
from typing import Any

from cg.tables.table import MethodTable, from_dict

FILE = "methods.json.gz"


@cache
def _lines() -> dict[str, bytes]:
    """Return the stored tables as text, by name; one is parsed when it is used."""
    text = gzip.decompress((files(__package__) / FILE).read_bytes())
    names, *lines = text.splitlines()
    return dict(zip(json.loads(names), lines, strict=True))


def stored_names() -> list[str]:
    """Return the names of the stored tables."""
    return list(_lines())


@cache
def stored_table(name: str) -> MethodTable:
    """Return a stored table."""
    return from_dict(json.loads(_lines()[name]))


def write_tables(path: Any, tables: list[MethodTable]) -> None:
    """Write the file of tables; it is the same for equal tables."""
    lines = [table.as_dict() for table in tables]
    text = "\n".join(json.dumps(line) for line in [[table.name for table in tables], *lines])
    path.write_bytes(gzip.compress(text.encode(), mtime=0))


def table_of(method: Any) -> MethodTable:
    """Return the table of a method.

    Parameters
    ----------
    method
        The name of a stored table, a file of a method, or any object with a method ``table()``.
    """
    if isinstance(method, str) and method in _lines():
        return stored_table(method)
    if not hasattr(method, "table"):
        # files, and messages for wrong names, come from where methods are made
        method = import_module("cg.construction.catalogue").resolve_method(method)
    table = method.table()
    if not isinstance(table, MethodTable):
        raise TypeError(f"method.table() must return a MethodTable, got {table!r}")
    return table


@lru_cache(maxsize=256)
def unique_table(method: Any, polynomial: bool = False) -> MethodTable:
    """Return the table of a method or its polynomial, the same one for equal methods."""
    if not polynomial:
        return table_of(method)
    table = unique_table(method).polynomial
    assert table is not None
    return table


def source_method(table: MethodTable) -> Any:
    """Return the method that a table was compiled from."""
    if table.method is not None:
        return table.method
    return import_module("cg.construction.catalogue").method_of(table.name)

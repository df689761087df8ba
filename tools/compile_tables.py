"""Compile the methods of the catalogue into the tables that integrations read.

A table that differs in rounding errors alone is kept: they depend on LAPACK.
Delete the file to compile all of them.
"""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from cg.construction.catalogue import methods, stored_methods
from cg.construction.methods.compile import compiled
from cg.construction.methods.method import Method
from cg.tables import MethodTable
from cg.tables.stored import FILE, stored_names, stored_table, write_tables

_ROUNDING = 1e-8
PATH = Path(__file__).parent.parent / "cg" / "tables" / FILE


def table(method: Method) -> MethodTable:
    """Return the table of a method as it is stored."""
    summary = methods.summaries.get(method.name, {})
    fresh = replace(compiled(method), method=None, real_stability=summary.get("real_stability"))
    stored = stored_table(method.name) if PATH.exists() and method.name in stored_names() else fresh
    return stored if close(stored.as_dict(), fresh.as_dict()) else fresh


def close(one: Any, other: Any, rounding: float = 1e-13) -> bool:
    """Return whether two tables are equal but for rounding errors, larger ones in ``output``."""
    if isinstance(one, dict):
        return one.keys() == other.keys() and all(
            close(one[key], other[key], _ROUNDING if key == "output" else rounding) for key in one
        )
    if isinstance(one, list):
        if np.shape(one) != np.shape(other):
            return False
        scale = max(1.0, np.abs(one).max(initial=0.0))
        return bool(np.abs(np.subtract(one, other)).max(initial=0.0) <= rounding * scale)
    if isinstance(one, float):
        return bool(abs(one - other) <= rounding)
    return bool(one == other)


if __name__ == "__main__":
    write_tables(PATH, [table(method) for method in stored_methods()])

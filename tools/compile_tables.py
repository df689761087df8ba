"""Compile the methods of the catalogue into the tables that integrations read."""

from dataclasses import replace
from pathlib import Path

from cg.construction.catalogue import methods, stored_methods
from cg.construction.methods.compile import compiled
from cg.construction.methods.method import Method
from cg.tables import MethodTable
from cg.tables.stored import FILE, write_tables

PATH = Path(__file__).parent.parent / "cg" / "tables" / FILE


def table(method: Method) -> MethodTable:
    """Return the table of a method as it is stored."""
    summary = methods.summaries.get(method.name, {})
    return replace(compiled(method), source=None, real_stability=summary.get("real_stability"))


if __name__ == "__main__":
    write_tables(PATH, [table(method) for method in stored_methods()])

"""Methods as tables: all that an integration reads of a method.

Methods are made and proved elsewhere, and compiled into tables; integrations read tables and know
nothing else of a method. Those of the catalogue are stored in ``methods.json.gz``, one line each.
"""

from cg.tables.stored import source_method, stored_names, stored_table, table_of, unique_table
from cg.tables.table import HasTable, Kind, MethodTable, basis_polynomials

__all__ = [
    "HasTable",
    "Kind",
    "MethodTable",
    "basis_polynomials",
    "source_method",
    "stored_names",
    "stored_table",
    "table_of",
    "unique_table",
]

"""Methods as tables: all that an integration reads of a method.

Methods are made and proved elsewhere, and compiled into tables; integrations read tables and know
nothing else of a method. Those of the catalogue are stored in ``methods.json.gz``, one line each.
"""

from cg.tables.stored import made, stored_names, stored_table, table_of
from cg.tables.table import HasTable, Kind, MethodTable, Output

__all__ = [
    "HasTable",
    "Kind",
    "MethodTable",
    "Output",
    "made",
    "stored_names",
    "stored_table",
    "table_of",
]

"""Records that Python shares with compiled code, as structures of C."""

from __future__ import annotations

import ctypes
from typing import Any

_KINDS: dict[str, Any] = {
    "integer": ctypes.c_int64,
    "real": ctypes.c_double,
    "address": ctypes.c_void_p,
}


def fields_of(entries: dict[str, str]) -> list[tuple[str, Any]]:
    """Return the fields of a structure from the entries of a record in `shared_numbers`."""
    return [(name, _KINDS[kind]) for name, kind in entries.items()]

"""All figures, tables and searches: whatever a module in the folder of sections lists."""

from __future__ import annotations

import pkgutil
from collections.abc import Iterable
from importlib import import_module

from . import sections
from .item import Item

__all__ = ["ITEMS", "select"]


def _found() -> list[Item]:
    names = [found.name for found in pkgutil.iter_modules(sections.__path__)]
    modules = [import_module(f"{sections.__name__}.{name}") for name in names]
    items = [item for module in modules for item in module.ITEMS]
    return sorted(items, key=lambda item: item.turn)


ITEMS = {item.name: item for item in _found()}
"""All items by name, in the order in which they run: the paper's first, those of seconds first."""


def select(names: Iterable[str]) -> list[Item]:
    """Return items and all that they need, in the order in which to run them.

    Raises
    ------
    KeyError
        If there is no item of such a name.
    """
    wanted: set[str] = set()
    pending = list(names)
    while pending:
        name = pending.pop()
        if name not in wanted:
            wanted.add(name)
            pending.extend(ITEMS[name].needs)
    return [item for item in ITEMS.values() if item.name in wanted]

"""All items of the report: those in the list ``ITEMS`` of each module in ``sections``."""

import pkgutil
from collections.abc import Iterable
from importlib import import_module

from . import sections
from .context import Item


def _all_items() -> list[Item]:
    names = [module.name for module in pkgutil.iter_modules(sections.__path__)]
    modules = [import_module(f"{sections.__name__}.{name}") for name in names]
    items = [item for module in modules for item in module.ITEMS]
    return sorted(items, key=lambda item: item.turn)


ITEMS = {item.name: item for item in _all_items()}
"""All items by name in the order of computation: those of the paper and quick ones first."""


def select(names: Iterable[str]) -> list[Item]:
    """Return items and all items that they need, in the order of computation.

    KeyError if there is no item with a given name.
    """
    selected: set[str] = set()
    pending = list(names)
    while pending:
        name = pending.pop()
        if name not in selected:
            selected.add(name)
            pending.extend(ITEMS[name].needs)
    return [item for item in ITEMS.values() if item.name in selected]

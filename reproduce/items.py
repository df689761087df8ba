"""The registry of all figures, tables and searches."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

from . import (
    appendix,
    beyond_catalogue,
    beyond_order,
    claims,
    fig4_1,
    fig4_2,
    fig4_2_quad,
    table3_2,
)
from .blocks import Block, Data
from .context import Context
from .search import item_functions

__all__ = ["ITEMS", "Item", "select"]


@dataclass(frozen=True)
class Item:
    """One part of the report.

    Attributes
    ----------
    name : str
        As ``--only`` takes it.
    title : str
    compute : callable
        From a `Context` to plain numbers.
    present : callable
        From those numbers to the blocks of a section; it computes nothing.
    needs : sequence of str
        Items whose numbers `compute` takes from ``context.results``.
    """

    name: str
    title: str
    compute: Callable[[Context], Data]
    present: Callable[[Data], Sequence[Block]]
    needs: Sequence[str] = ()


_LISTED = (
    Item("table3.2", "Table of Section 3.2", table3_2.compute, table3_2.present),
    Item("appendix", "Appendix A", appendix.compute, appendix.present),
    Item("fig4.1", "Figure 4.1", fig4_1.compute, fig4_1.present),
    Item("fig4.2", "Figure 4.2", fig4_2.compute, fig4_2.present),
    Item("fig4.2quad", "Figure 4.2 in real(16)", fig4_2_quad.compute, fig4_2_quad.present),
    Item("search4", "Search: order 4, 5 stages", *item_functions(4)),
    Item("search5", "Search: order 5, 9 stages", *item_functions(5)),
    Item("search6", "Search: order 6, 16 stages", *item_functions(6)),
    Item("claims", "What the paper claims", claims.compute, claims.present, claims.NEEDS),
    Item(
        "beyond.order",
        "Beyond the paper: exact methods of order six and more",
        beyond_order.compute,
        beyond_order.present,
    ),
    Item(
        "beyond.catalogue",
        "Beyond the paper: the catalogue",
        beyond_catalogue.compute,
        beyond_catalogue.present,
    ),
)

ITEMS = {item.name: item for item in _LISTED}
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
    return [item for item in _LISTED if item.name in wanted]

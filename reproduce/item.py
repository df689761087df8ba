"""What one part of the report is."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from .blocks import Block, Data
from .context import Context

__all__ = ["Item"]


@dataclass(frozen=True)
class Item:
    """One part of the report.

    Attributes
    ----------
    name : str
        As ``--only`` takes it.
    title : str
    turn : int
        When it is computed: after those with smaller numbers.
    place : int
        Where it is shown in the report, likewise.
    compute : callable
        From a `Context` to plain numbers.
    present : callable
        From those numbers to the blocks of a section; it computes nothing.
    needs : sequence of str
        Items whose numbers `compute` takes from ``context.results``.
    """

    name: str
    title: str
    turn: int
    place: int
    compute: Callable[[Context], Data]
    present: Callable[[Data], Sequence[Block]]
    needs: Sequence[str] = ()

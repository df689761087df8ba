"""The record that describes one part of the report."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from .blocks import Block, Data
from .context import Context


@dataclass(frozen=True)
class Item:
    """One part of the report.

    Attributes
    ----------
    name : str
        Its name for ``--only``.
    title : str
    turn : int
        Items are computed in ascending order of this number.
    place : int
        Items are shown in ascending order of this number.
    compute : callable
        Returns plain data for a `Context`. If the entry ``partial`` exists and is not null, it
        has the numbers of finished ``starts`` and ``of`` all starts.
    present : callable
        Returns the blocks of a section for these data, without further computation.
    needs : sequence of str
        Items whose data `compute` reads from ``context.results``.
    """

    name: str
    title: str
    turn: int
    place: int
    compute: Callable[[Context], Data]
    present: Callable[[Data], Sequence[Block]]
    needs: Sequence[str] = ()

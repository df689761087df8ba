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
        From a `Context` to plain numbers. ``partial`` among them says, if it is there and not
        null, of how many starts ``of`` how many they are.
    present : callable
        From those numbers to the blocks of a section; it computes nothing.
    needs : sequence of str
        Items whose numbers `compute` takes from ``context.results``.
    cost : pair of float
        Seconds of one core that it took where it was measured, by default and in full; what
        predictions of the time left begin with.
    limited : bool
        Whether `compute` heeds ``context.limit``.
    """

    name: str
    title: str
    turn: int
    place: int
    compute: Callable[[Context], Data]
    present: Callable[[Data], Sequence[Block]]
    needs: Sequence[str] = ()
    cost: tuple[float, float] = (1.0, 1.0)
    limited: bool = False

"""The record that describes one part of the report."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from .blocks import Block, Data
from .context import Context


@dataclass(frozen=True)
class Item:
    """One part of the report, with its name for ``--only``.

    Items are computed in ascending order of `turn`, and shown in that of `place`. `compute` returns
    plain data for a `Context`; if these have an entry ``partial`` that is not null, it has the
    numbers of finished ``starts`` and ``of`` all starts. `present` returns the blocks of a section
    for these data, without further computation. `needs` are the items whose data `compute` reads
    from ``context.results``.
    """

    name: str
    title: str
    turn: int
    place: int
    compute: Callable[[Context], Data]
    present: Callable[[Data], Sequence[Block]]
    needs: Sequence[str] = ()

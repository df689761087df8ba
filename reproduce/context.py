"""Items, the parts of the report, and their input: settings, resources and earlier results."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from cg.support.parallel import available_cores

from .blocks import Block, Data

Progress = Callable[[int, int], None]
"""Function of the numbers of finished and of all parts of an item."""


@dataclass(frozen=True)
class Settings:
    """Settings that determine the numbers of a run.

    `seed` is that of all random starts; `full` searches extensively.
    """

    seed: int = 0
    full: bool = False


@dataclass(frozen=True)
class Context:
    """Settings, resources and earlier results.

    `checkpoints` is the folder for files from which a killed run continues, `workers` a number of
    threads or processes. `results` has by name the data of the items that this one needs.
    """

    settings: Settings
    checkpoints: Path
    workers: int = field(default_factory=available_cores)
    progress: Progress = lambda done, total: None
    results: Mapping[str, Data] = field(default_factory=dict)

    def report_work(self, done: float, total: float) -> None:
        """Report progress in percent of the work, where parts take times that differ much."""
        self.progress(int(100 * done / total), 100)


@dataclass(frozen=True)
class Item:
    """One part of the report, with its name for ``--only``.

    Items are computed in ascending order of `turn`, and shown in that of `place`. `compute` returns
    plain data for a `Context`. `present` returns the blocks of a section for these data, without
    further computation. `needs` are the items whose data `compute` reads from ``context.results``.
    """

    name: str
    title: str
    turn: int
    place: int
    compute: Callable[[Context], Data]
    present: Callable[[Data], Sequence[Block]]
    needs: Sequence[str] = ()

"""Items, the parts of the report: their input; text, tables and charts of their sections."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from cg.support.parallel import available_cores

Data = Mapping[str, Any]
"""The data of an item, which JSON can represent."""


@dataclass(frozen=True)
class Text:
    """A paragraph of plain text."""

    text: str


@dataclass(frozen=True)
class Table:
    """A table of strings; each row is as long as the header.

    A cell ``"pass"``, ``"fail"`` or ``"not reproducible"`` is marked as a verdict. `numeric` aligns
    the cells to the right, in digits of equal width; `folded` shows only the caption until the
    reader opens the table.
    """

    caption: str
    header: Sequence[str]
    rows: Sequence[Sequence[str]]
    numeric: bool = True
    folded: bool = False

    def __post_init__(self) -> None:
        for row in self.rows:
            if len(row) != len(self.header):
                raise ValueError(f"a row must have {len(self.header)} cells, got {row}")


@dataclass(frozen=True)
class Chart:
    """A figure with a caption, which `draw` draws on an empty figure when the report is written.

    `name` is that of its files, without suffix; `description` is the alternative text; `size` is
    the width and height in inches.
    """

    name: str
    draw: Callable[[Figure], None]
    caption: str
    description: str
    size: tuple[float, float] = (9.0, 4.0)


Block = Text | Table | Chart


def number(value: float | int | None, digits: int = 3) -> str:
    """Return a number with some significant digits and a minus sign (−), or – for None."""
    if value is None:
        return "–"
    text = f"{value:.{digits}g}" if isinstance(value, float) else str(value)
    return text.replace("-", "−")


def places(value: float | None, count: int = 3) -> str:
    """Return a number with a fixed number of decimals, or – for None."""
    return "–" if value is None else f"{value:.{count}f}".replace("-", "−")


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


def quartiles(values: Sequence[float]) -> list[float] | None:
    """Return minimum, quartiles and maximum, or None if there are no values.

    The results are values of the sample: f spans many powers of ten, so interpolation between
    neighbours would be meaningless.
    """
    if not values:
        return None
    five: list[float] = np.quantile(values, (0, 0.25, 0.5, 0.75, 1), method="nearest").tolist()
    return five


def median(values: Sequence[float]) -> float:
    """Return the median, as defined by `quartiles`; ValueError if there are no values."""
    five = quartiles(values)
    if five is None:
        raise ValueError("values must not be empty")
    return five[2]

"""The parts of a section of the report: text, tables and charts."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from matplotlib.figure import Figure

Data = Mapping[str, Any]
"""The data of an item, which JSON can represent."""


@dataclass(frozen=True)
class Text:
    """A paragraph of plain text."""

    text: str


@dataclass(frozen=True)
class Table:
    """A table of strings.

    Attributes
    ----------
    caption : str
    header : sequence of str
    rows : sequence of sequences of str
        Each as long as the header. A cell ``"pass"``, ``"fail"`` or ``"not reproducible"``
        is marked as a verdict.
    numeric : bool
        Align the cells to the right, in digits of equal width.
    folded : bool
        Show only the caption until the reader opens the table.
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
    """A figure, drawn when the report is written.

    Attributes
    ----------
    name : str
        Name of its files, without suffix.
    draw : callable
        Draws on an empty figure.
    caption : str
        Text below the figure.
    description : str
        Alternative text.
    size : pair of float
        Width and height in inches.
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

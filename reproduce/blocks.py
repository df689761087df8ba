"""The parts of a section of the report: text, tables and charts."""

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

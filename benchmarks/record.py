"""The result of a benchmark: one section of the page."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any


@dataclass(frozen=True)
class Row:
    """One measured quantity, and the same quantity of a competitor.

    Attributes
    ----------
    quantity : str
        Description of the quantity.
    value : float
        The result of this package.
    unit : str
        Unit of `value` and `other`.
    against : str
        Name of the competitor; empty if there is none.
    other : float or None
        The result of the competitor; None if there is none.
    ratio : float or None
        Median of the quotient over repetitions.
    spread : pair of float or None
        The quartiles of the quotient.
    """

    quantity: str
    value: float
    unit: str
    against: str = ""
    other: float | None = None
    ratio: float | None = None
    spread: tuple[float, float] | None = None


@dataclass(frozen=True)
class Result:
    """The result of one benchmark: one section of the page.

    Attributes
    ----------
    title : str
    method : str
        How it was measured.
    rows : tuple of Row
    notes : tuple of str
        Paragraphs, lists and tables in Markdown, shown after the rows.
    numbers : mapping
        Numbers for other pages.
    """

    title: str
    method: str
    rows: tuple[Row, ...] = ()
    notes: tuple[str, ...] = ()
    numbers: Mapping[str, Any] = field(default_factory=dict)

    def data(self) -> dict[str, Any]:
        """Return the result as data for JSON."""
        return asdict(self)

    @classmethod
    def from_data(cls, data: Mapping[str, Any]) -> Result:
        """Make a result from what `data` returned."""
        rows = tuple(Row(**row) for row in data["rows"])
        return cls(data["title"], data["method"], rows, tuple(data["notes"]), data["numbers"])

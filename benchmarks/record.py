"""The result of a benchmark: rows of a table, notes and figures."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any


@dataclass(frozen=True)
class Aim:
    """A bound on a number, set before it was measured.

    Attributes
    ----------
    bound : float
    above : bool
        Whether `bound` is a lower bound; otherwise it is an upper bound.
    of : {"value", "ratio"}
        The bounded field of the row.
    """

    bound: float
    above: bool
    of: str = "ratio"


@dataclass(frozen=True)
class Row:
    """One measured quantity, and the same quantity of a competitor.

    Attributes
    ----------
    quantity : str
        Description of the quantity.
    value : float
        The result of this package; NaN if there is none.
    unit : str
        Unit of `value` and `other`.
    against : str
        Name of the competitor; empty if there is none.
    other : float or None
        The result of the competitor; None if there is none.
    ratio : float or None
        Median of the quotient over repetitions. Larger is better, unless the aim is an upper
        bound.
    ratio_is_bound : bool
        Whether the competitor found nothing, so that the ratio is a lower bound.
    aim : Aim or None
    spread : pair of float or None
        The quartiles of the quotient.
    """

    quantity: str
    value: float
    unit: str
    against: str = ""
    other: float | None = None
    ratio: float | None = None
    ratio_is_bound: bool = False
    aim: Aim | None = None
    spread: tuple[float, float] | None = None

    @property
    def met(self) -> bool | None:
        """Whether the aim is met; None if there is none."""
        if self.aim is None:
            return None
        number = self.value if self.aim.of == "value" else self.ratio
        if number is None or math.isnan(number):
            return False
        return number >= self.aim.bound if self.aim.above else number <= self.aim.bound


@dataclass(frozen=True)
class Figure:
    """A figure drawn by a benchmark.

    Attributes
    ----------
    name : str
        Name of the files, without suffix.
    caption : str
    """

    name: str
    caption: str


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
    figures : tuple of Figure
    details : Result or None
        A section of the page with all tables, for numbers that the main page omits.
    """

    title: str
    method: str
    rows: tuple[Row, ...]
    notes: tuple[str, ...] = ()
    figures: tuple[Figure, ...] = ()
    details: Result | None = None

    def data(self) -> dict[str, Any]:
        """Return the result as data for JSON, with None for NaN."""
        data = asdict(self)
        for row in data["rows"]:
            for key in ("value", "other"):
                if row[key] is not None and math.isnan(row[key]):
                    row[key] = None
        data["details"] = None if self.details is None else self.details.data()
        return data

    @classmethod
    def from_data(cls, data: Mapping[str, Any]) -> Result:
        """Make a result from what `data` returned."""
        rows = []
        for row in data["rows"]:
            aim = row["aim"]
            value = math.nan if row["value"] is None else row["value"]
            aim = None if aim is None else Aim(**aim)
            rows.append(Row(**{**row, "value": value, "aim": aim}))
        figures = tuple(Figure(**figure) for figure in data["figures"])
        details = None if data["details"] is None else cls.from_data(data["details"])
        notes = tuple(data["notes"])
        return cls(data["title"], data["method"], tuple(rows), notes, figures, details)

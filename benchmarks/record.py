"""What a benchmark says: rows of a table, notes and figures."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

__all__ = ["Aim", "Figure", "Result", "Row"]


@dataclass(frozen=True)
class Aim:
    """A bound that was set before measuring.

    Attributes
    ----------
    bound : float
    above : bool
        Whether the number should be at least `bound`, instead of at most.
    of : {"value", "ratio"}
        What it bounds.
    """

    bound: float
    above: bool
    of: str = "ratio"


@dataclass(frozen=True)
class Row:
    """One measured quantity, beside the same quantity of something else.

    Attributes
    ----------
    quantity : str
        What was measured.
    value : float
        The project's number; NaN if there is none.
    unit : str
        Of `value` and `other`.
    against : str
        What it is compared with; empty if with nothing.
    other : float or None
        Its number; None if there is none.
    ratio : float or None
        Median over repetitions of the quotient, arranged so that more is better, unless
        the aim says at most.
    ratio_is_bound : bool
        Whether the other found nothing, so that the ratio is a lower bound.
    aim : Aim or None
    """

    quantity: str
    value: float
    unit: str
    against: str = ""
    other: float | None = None
    ratio: float | None = None
    ratio_is_bound: bool = False
    aim: Aim | None = None

    @property
    def met(self) -> bool | None:
        """Whether the aim was reached; None if there is none."""
        if self.aim is None:
            return None
        number = self.value if self.aim.of == "value" else self.ratio
        if number is None or math.isnan(number):
            return False
        return number >= self.aim.bound if self.aim.above else number <= self.aim.bound


@dataclass(frozen=True)
class Figure:
    """A figure that a benchmark drew.

    Attributes
    ----------
    name : str
        Of the files, without suffix.
    caption : str
    """

    name: str
    caption: str


@dataclass(frozen=True)
class Result:
    """What one benchmark measured.

    Attributes
    ----------
    title : str
    method : str
        How it was measured, in a sentence or two.
    rows : tuple of Row
    notes : tuple of str
        What a reader must know to judge the numbers.
    figures : tuple of Figure
    """

    title: str
    method: str
    rows: tuple[Row, ...]
    notes: tuple[str, ...] = ()
    figures: tuple[Figure, ...] = ()

    def data(self) -> dict[str, Any]:
        """Return it as plain data, None for numbers that there aren't."""
        data = asdict(self)
        for row in data["rows"]:
            for key in ("value", "other"):
                if row[key] is not None and math.isnan(row[key]):
                    row[key] = None
        return data

    @classmethod
    def from_data(cls, data: Mapping[str, Any]) -> Result:
        """Make it again of what `data` returned."""
        rows = []
        for row in data["rows"]:
            aim = row["aim"]
            value = math.nan if row["value"] is None else row["value"]
            aim = None if aim is None else Aim(**aim)
            rows.append(Row(**{**row, "value": value, "aim": aim}))
        figures = tuple(Figure(**figure) for figure in data["figures"])
        return cls(data["title"], data["method"], tuple(rows), tuple(data["notes"]), figures)

"""Records of a search: what it does, and what became of each random start."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

from .conditions import Rows
from .layout import Layout

__all__ = ["Phase", "RandomStart", "SearchSettings"]


@dataclass(frozen=True)
class Phase:
    """How one run of the solver ended.

    Attributes
    ----------
    f : float
        Sum of squared residuals over the independent conditions, the objective of the paper;
        for a refined point of the minimum-norm solver a bound on that over all conditions.
    info : int
        Why the solver stopped: `cg.shared_numbers.Status` or `cg.shared_numbers.MinimumNormStatus`.
    nfev : int
        Evaluations of the residuals, those for difference quotients included.
    """

    f: float
    info: int
    nfev: int


@dataclass(frozen=True)
class RandomStart:
    """One random start and what became of it.

    Attributes
    ----------
    index : int
        Number of the start; with the seed it determines everything else.
    double : Phase
        The run in double precision.
    quad : Phase or None
        The run in real(16); None where `double` ended above the bound for it.
    x : tuple of str
        Packed coefficients, row by row, ``b`` last, or point by point, in decimal with 36
        significant digits.
    largest_residual : float
        Over all order conditions, computed in real(16) at `x`.
    exact : bool
        Whether `x` solves all conditions to the accuracy of real(16).
    """

    index: int
    double: Phase
    quad: Phase | None
    x: tuple[str, ...]
    largest_residual: float
    exact: bool

    def record(self) -> dict[str, Any]:
        """Return it as plain data, from which `from_record` makes it again."""
        return asdict(self)

    @classmethod
    def from_record(cls, record: Mapping[str, Any]) -> RandomStart:
        """Read what `record` wrote.

        Raises
        ------
        ValueError
            If a field is missing or of the wrong kind.
        """
        try:
            refined = record["quad"]
            return cls(
                index=int(record["index"]),
                double=Phase(**record["double"]),
                quad=None if refined is None else Phase(**refined),
                x=tuple(map(str, record["x"])),
                largest_residual=float(record["largest_residual"]),
                exact=bool(record["exact"]),
            )
        except (KeyError, TypeError) as error:
            raise ValueError(f"not the record of a start: {str(record)[:80]}") from error


@dataclass(frozen=True)
class SearchSettings:
    """What a search does; equal settings give equal results.

    See `search` for the parameters.
    """

    order: int
    stages: int
    seed: int
    algorithm: str
    rows: Rows
    width: float
    maxfev: int
    refine_below: float
    refine_maxfev: int
    flows: int | None = None
    embedded: bool = False
    tree: Layout | None = None
    first_same_as_last: bool = False

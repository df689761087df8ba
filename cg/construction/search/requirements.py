"""Requirements on the methods of a search, and the quantity to minimise along solution sets."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from cg.construction.candidate import Candidate
from cg.construction.conditions import MAX_ORDER
from cg.construction.optimise import Goals, optimise
from cg.support.checks import check_interval, check_real

OBJECTIVES = ("principal_error", "largest_coefficient")

_WEIGHT = 30.0  # weight of violated bounds, beside a principal error of weight 1
_MARGIN = 0.01  # by which penalties start before the bounds, relative
_ROUNDING = 1e-9  # error of abscissae and coefficients that are at their bounds


@dataclass(frozen=True)
class Requirements:
    """What the methods of a search must satisfy, and what is minimised; see `cg.search`."""

    abscissae: tuple[float, float] | None = None
    bound: float | None = None
    minimise: str | None = None

    @classmethod
    def checked(cls, order: int, abscissae: Any, bound: Any, minimise: Any) -> Requirements:
        """Return the requirements of the arguments of `cg.search`, after checking them."""
        if abscissae is not None:
            abscissae = check_interval("abscissae", abscissae)
        if bound is not None:
            bound = check_real("bound", bound, positive=True)
        if minimise is not None and (not isinstance(minimise, str) or minimise not in OBJECTIVES):
            raise ValueError(f"minimise must be one of {', '.join(OBJECTIVES)}, got {minimise!r}")
        if minimise == "principal_error" and order >= MAX_ORDER:
            raise ValueError(f"minimise: order must be below {MAX_ORDER}, got {order}")
        return cls(abscissae, bound, minimise)

    def __str__(self) -> str:
        parts = (
            [] if self.abscissae is None else ["abscissae from {} to {}".format(*self.abscissae)]
        )
        parts += [] if self.bound is None else [f"coefficients of at most {self.bound}"]
        parts += [f"a small {self.minimise.replace('_', ' ')}"] if self.minimise else []
        return " and ".join(parts)

    @property
    def goals(self) -> Goals:
        """The objective of the optimisation."""
        lower, upper = self.abscissae or (0.0, 1.0)
        margin = _MARGIN * (upper - lower)
        return Goals(
            principal_error=float(self.minimise == "principal_error"),
            coefficients=float(self.minimise == "largest_coefficient"),
            abscissae=0.0 if self.abscissae is None else _WEIGHT,
            interval=(lower + margin, upper - margin),
            bound=(self.bound or 1.0) * (1 - _MARGIN),
            bound_weight=0.0 if self.bound is None else _WEIGHT,
        )

    def satisfied(self, candidate: Candidate) -> bool:
        """Return whether a candidate is within the bounds."""
        lower, upper = self.abscissae or (-np.inf, np.inf)
        c = candidate.abscissae
        largest = np.inf if self.bound is None else self.bound * (1 + _ROUNDING)
        inside = bool(((lower - _ROUNDING <= c) & (c <= upper + _ROUNDING)).all())
        return inside and candidate.largest <= largest

    def improve(self, candidate: Candidate) -> Candidate | None:
        """Return a candidate on the solution set that satisfies them; None if none was reached."""
        if self.minimise or not self.satisfied(candidate):
            candidate = optimise(candidate, self.goals)
        return candidate if self.satisfied(candidate) else None

    def key(self, candidate: Candidate) -> float:
        """Return the number by which methods are sorted."""
        if self.minimise == "principal_error":
            return candidate.principal_error
        return round(candidate.largest, 8)

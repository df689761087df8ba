"""Results of the random starts of a search."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Phase:
    """The result of one call of a solver."""

    f: float  # sum of squared residuals, or a bound of it
    info: int  # a `Status` or `MinimumNormStatus`
    nfev: int  # evaluations of residuals


@dataclass(frozen=True)
class RandomStart:
    """The result of one random start, which its number `index` and the settings determine."""

    index: int
    double: Phase
    quad: Phase | None  # None if `double` ended above `refine_below`
    x: tuple[str, ...]  # packed coefficients, 36 digits
    largest_residual: float  # over all order conditions, in real(16)
    exact: bool  # whether that is rounding error

    @property
    def f(self) -> float:
        """Final sum of squared residuals."""
        return (self.quad or self.double).f

    @classmethod
    def of_fields(cls, fields: Mapping[str, Any]) -> RandomStart:
        """Return the start that `dataclasses.asdict` made fields of."""
        double, quad, x = (fields[name] for name in ("double", "quad", "x"))
        phases = {"double": Phase(**double), "quad": None if quad is None else Phase(**quad)}
        return cls(**{**fields, **phases, "x": tuple(x)})

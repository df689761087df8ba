"""Results of the random starts of a search."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass

import numpy as np

from cg.construction.layouts.layout import Layout
from cg.construction.runs import StoredStart
from cg.support import quads


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
    largest_residual: float  # of all order conditions in real(16)
    exact: bool  # whether that is rounding error

    @property
    def f(self) -> float:
        """Final sum of squared residuals."""
        return (self.quad or self.double).f

    def entry(self, layout: Layout, *, drawn: bool, seconds: float = 0.0) -> StoredStart:
        """Return the entry of the start, with its `layout` if that was `drawn` at random."""
        bits = quads.encode(self.x)
        return StoredStart(
            number=self.index,
            stages=len(layout.stage_points),
            flows=len(layout.parents) if layout.rows is None else None,
            tree=json.dumps(asdict(layout)) if drawn else None,
            phase="double" if self.quad is None else "quad",
            f=self.double.f,
            status=self.double.info,
            evaluations=self.double.nfev,
            refined_f=None if self.quad is None else self.quad.f,
            refined_status=None if self.quad is None else self.quad.info,
            refined_evaluations=None if self.quad is None else self.quad.nfev,
            largest_residual=self.largest_residual,
            solved=self.exact,
            coefficients=bits.tobytes(),
            seconds=seconds,
        )

    @classmethod
    def from_entry(cls, entry: StoredStart) -> RandomStart:
        """Return the start of an entry; ValueError if a field is missing or of the wrong kind."""
        where = f"not the entry of a start: start {entry.number}"
        refined = None
        try:
            if entry.phase == "quad":
                refined = _phase(entry.refined_f, entry.refined_status, entry.refined_evaluations)
                x = tuple(map(quads.to_decimal, quads.decode(entry.quads)))
            else:
                # doubles: formatting them is faster than converting fractions
                doubles = quads.to_float(entry.quads)
                if not np.isfinite(doubles).all():
                    raise ValueError("a coefficient is not finite")
                x = tuple(f"{entry:.35e}" for entry in doubles.tolist())
            return cls(
                index=entry.number,
                double=_phase(entry.f, entry.status, entry.evaluations),
                quad=refined,
                x=x,
                largest_residual=float(entry.largest_residual),  # type: ignore[arg-type]
                exact=entry.solved,
            )
        except (TypeError, ValueError, OverflowError) as error:
            raise ValueError(f"{where}: {error}") from None


def _phase(f: float | None, status: int | None, evaluations: int | None) -> Phase:
    if not isinstance(f, float) or not isinstance(status, int) or not isinstance(evaluations, int):
        raise TypeError(f"a phase is {(f, status, evaluations)}")
    return Phase(f, status, evaluations)

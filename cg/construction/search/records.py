"""What became of each random start of a search."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass

from ...runs import Record
from ...structure.layout import Layout
from ...support import quads

__all__ = ["Phase", "RandomStart"]


@dataclass(frozen=True)
class Phase:
    """How one run of the solver ended.

    Attributes
    ----------
    f : float
        Sum of squared residuals over the independent conditions, the objective of the paper;
        for a refined point of the minimum-norm solver a bound on that over all conditions.
    info : int
        Why the solver stopped: `Status` or `MinimumNormStatus` of `cg.support.shared_numbers`.
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

    @property
    def f(self) -> float:
        """Sum of squared residuals where the last solver ended."""
        return (self.quad or self.double).f

    def record(self, layout: Layout, *, drawn: bool, seconds: float = 0.0) -> Record:
        """Return what a store keeps of it, from which `from_record` makes it again.

        Parameters
        ----------
        layout : Layout
            Of the methods that it looked for.
        drawn : bool
            Whether that was drawn with the start, and is kept too.
        seconds : float, optional
            That it took.
        """
        bits = quads.encode(self.x)
        return Record(
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
    def from_record(cls, record: Record) -> RandomStart:
        """Make it again of what `record` returned.

        Raises
        ------
        ValueError
            If a field is missing or of the wrong kind.
        """
        where = f"not the record of a start: start {record.number}"
        refined = None
        try:
            if record.phase == "quad":
                refined = _phase(
                    record.refined_f, record.refined_status, record.refined_evaluations
                )
                x = tuple(map(quads.to_decimal, quads.decode(record.quads)))
            else:
                # doubles, whose decimals take less time without fractions
                x = tuple(f"{entry:.35e}" for entry in quads.to_float(record.quads).tolist())
            return cls(
                index=record.number,
                double=_phase(record.f, record.status, record.evaluations),
                quad=refined,
                x=x,
                largest_residual=float(record.largest_residual),  # type: ignore[arg-type]
                exact=record.solved,
            )
        except (TypeError, ValueError, OverflowError) as error:
            raise ValueError(f"{where}: {error}") from None


def _phase(f: float | None, status: int | None, evaluations: int | None) -> Phase:
    if not isinstance(f, float) or not isinstance(status, int) or not isinstance(evaluations, int):
        raise TypeError(f"a phase is {(f, status, evaluations)}")
    return Phase(f, status, evaluations)

"""Entries of a store: starts, failures, summaries of runs."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, kw_only=True)
class StoredStart:
    """The result of one random start, as a store keeps it."""

    number: int
    stages: int
    flows: int | None = None  # None for tableaux
    tree: str | None = None  # JSON, if it was drawn with the start
    phase: str  # arithmetic of the last solver, "double" or "quad"
    f: float  # sum of squared residuals after the solver in double precision
    status: int | None = None  # of the solver in double precision
    evaluations: int | None = None  # of residuals
    refined_f: float | None = None
    refined_status: int | None = None
    refined_evaluations: int | None = None
    largest_residual: float | None = None  # among all order conditions
    solved: bool
    coefficients: bytes  # packed, in binary128 of 16 bytes each
    seconds: float = 0.0

    @property
    def quads(self) -> NDArray[np.int8]:
        """The coefficients in binary128, shape (n, 16), see `cg.support.quads`."""
        return np.frombuffer(self.coefficients, np.int8).reshape(-1, 16)


@dataclass(frozen=True)
class Failure:
    """A start whose worker died, by number, and why."""

    index: int
    message: str


@dataclass(frozen=True)
class RunSummary:
    """Settings and progress of a run in a store."""

    number: int
    kind: str  # "search" or "construct"
    settings: dict[str, Any]  # that determine its results
    versions: dict[str, str]  # of the package, Python and the machine that began it
    created: float  # seconds since 1970, as `changed`
    changed: float
    starts: int
    solved: int
    failed: int
    best: float | None  # smallest sum of squared residuals
    seconds: float  # duration of all starts
    running: bool  # whether a process is carrying it out

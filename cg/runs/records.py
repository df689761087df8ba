"""Records of a store: starts, failures, summaries of runs."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, kw_only=True)
class Record:
    """The result of one random start, as a store keeps it.

    `number` and the settings of the run determine the rest except `seconds`. `flows` is None for
    tableaux; `tree` is JSON, and only there if it was drawn with the start. `phase` is the
    arithmetic of the last solver, ``"double"`` or ``"quad"``. `f` is the sum of squared residuals
    after the run in double precision, with the final `status` of the solver and the `evaluations`
    of residuals; the `refined` ones are those of the refinement. `largest_residual` is that of all
    order conditions. `coefficients` are packed, in binary128 of 16 bytes each.
    """

    number: int
    stages: int
    flows: int | None = None
    tree: str | None = None
    phase: str
    f: float
    status: int | None = None
    evaluations: int | None = None
    refined_f: float | None = None
    refined_status: int | None = None
    refined_evaluations: int | None = None
    largest_residual: float | None = None
    solved: bool
    coefficients: bytes
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
    """Settings and progress of a run in a store.

    `kind` is ``"search"`` or ``"construct"``; `settings` determine its results; `versions` are
    those of the package, Python and the machine that began it. It was `created` and last `changed`
    at these seconds since 1970. `starts`, `solved` and `failed` are numbers of starts, `best` is
    the smallest sum of squared residuals, `seconds` the duration of all starts. `running` says
    whether a process is carrying it out.
    """

    number: int
    kind: str
    settings: dict[str, Any]
    versions: dict[str, str]
    created: float
    changed: float
    starts: int
    solved: int
    failed: int
    best: float | None
    seconds: float
    running: bool

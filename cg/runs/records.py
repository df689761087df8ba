"""Records of a store: starts, failures, summaries of runs."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, kw_only=True)
class Record:
    """The result of one random start, as a store keeps it.

    Attributes
    ----------
    number : int
        Number of the start; with the settings of the run it determines the rest except `seconds`.
    stages : int
    flows : int or None
        Number of flows; None for tableaux.
    tree : str or None
        The tree of points as JSON if it was drawn with the start.
    phase : {"double", "quad"}
        Arithmetic of the last solver.
    f : float
        Sum of squared residuals after the run in double precision.
    status, evaluations : int or None
        Final status of the solver in double precision, and evaluations of the residuals.
    refined_f, refined_status, refined_evaluations : float, int, int, or None
        The same for the refinement.
    largest_residual : float or None
        Largest residual of all order conditions.
    solved : bool
        Whether the start led to a method.
    coefficients : bytes
        Packed coefficients in binary128, 16 bytes each.
    seconds : float
        Duration of the start.
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
        """The coefficients in binary128, shape (n, 16), see `cg.support.quads`.

        ValueError if the number of bytes isn't a multiple of 16.
        """
        return np.frombuffer(self.coefficients, np.int8).reshape(-1, 16)


@dataclass(frozen=True)
class Failure:
    """A start whose worker died.

    Attributes
    ----------
    index : int
        Number of the start; with the seed it determines everything else.
    message : str
        Why it died.
    """

    index: int
    message: str


@dataclass(frozen=True)
class RunSummary:
    """Settings and progress of a run in a store.

    Attributes
    ----------
    number : int
        Number of the run in the store.
    kind : {"search", "construct"}
    settings : dict
        All that determines the results.
    versions : dict
        Versions of the package, Python and the machine that began the run.
    created, changed : float
        Seconds since 1970: when the run began, and when its last start was recorded.
    starts, solved, failed : int
        Numbers of finished starts, of those that led to a method, and of failures.
    best : float or None
        Smallest sum of squared residuals, after refinement if there was one.
    seconds : float
        Total duration of all starts.
    running : bool
        Whether a process is carrying it out.
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

"""What a store keeps: of a start, of one whose worker died, of a run."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = ["Failure", "Record", "RunSummary"]


@dataclass(frozen=True)
class Record:
    """What a store keeps of one random start.

    Attributes
    ----------
    number : int
        Index of the start; with the run's settings it determines the rest but for `seconds`.
    stages : int
    flows : int or None
        Where they count.
    tree : str or None
        The tree of points as JSON, where it was drawn with the start.
    phase : {"double", "quad"}
        Arithmetic of the last solver that ran.
    f : float
        Sum of squared residuals after the run in double precision.
    status, evaluations : int or None
        Of the solver in double precision.
    refined_f, refined_status, refined_evaluations : float, int, int, or None
        The same of the refinement.
    largest_residual : float or None
        Over all order conditions, at the coefficients.
    solved : bool
        Whether the start led to what was wanted.
    coefficients : bytes
        Packed, 16 bytes each: binary128.
    seconds : float
        Time that the start took.
    """

    number: int
    stages: int
    flows: int | None
    tree: str | None
    phase: str
    f: float
    status: int | None
    evaluations: int | None
    refined_f: float | None
    refined_status: int | None
    refined_evaluations: int | None
    largest_residual: float | None
    solved: bool
    coefficients: bytes
    seconds: float = 0.0

    @property
    def quads(self) -> NDArray[np.int8]:
        """The coefficients in binary128, shape (n, 16), see `cg.support.quads`.

        Raises
        ------
        ValueError
            If the number of bytes isn't a multiple of 16.
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
        What became known of it.
    """

    index: int
    message: str


@dataclass(frozen=True)
class RunSummary:
    """A run of a store, and how far it is.

    Attributes
    ----------
    number : int
        By which the store knows the run.
    kind : {"search", "construct"}
    settings : dict
        What determines the results.
    versions : dict
        Of the package, Python and the machine that began the run.
    created, changed : float
        Seconds since 1970: when the run began, and when its last start was recorded.
    starts, solved, failed : int
        Starts recorded, how many of them led to what was wanted, and those whose worker died.
    best : float or None
        Smallest sum of squared residuals, refined where it was.
    seconds : float
        Time of all starts together.
    running : bool
        Whether a process is at work on it.
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

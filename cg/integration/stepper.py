"""What takes the steps of an integration, and gives them away in blocks."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass, field, fields

from cg.frames.arrays import Array, Points
from cg.frames.base import Frame
from cg.integration.error_norm import ErrorNorm
from cg.method import Method
from cg.munthe_kaas import MuntheKaas

__all__ = ["AdaptiveSchedule", "Block", "Stepper", "advances_by_embedded", "error_exponent"]


@dataclass(frozen=True)
class AdaptiveSchedule:
    """Steps that an error estimate calls for.

    Attributes
    ----------
    start, stop
        The ends.
    norm
        Measures the error.
    max_step
        Largest step size, positive.
    first_step
        Size of the first step, or None to choose it from the problem.
    max_steps
        Largest number of steps, rejected ones included.
    """

    start: float
    stop: float
    norm: ErrorNorm
    max_step: float = math.inf
    first_step: float | None = None
    max_steps: int = 10**6


@dataclass(frozen=True)
class Block:
    """Steps that follow each other.

    Attributes
    ----------
    t
        Where the first one starts, then their ends; shape ``(n + 1,)``.
    y
        Points there, shape ``(n + 1, *batch, *point_shape)``; NaN for members of an ensemble that
        have ended.
    slopes
        Coefficients at the beginnings of the steps, shape ``(n, *batch, dim)``, or None if they
        weren't asked for.
    """

    t: Array
    y: Points
    slopes: Array | None

    def __len__(self) -> int:
        return len(self.t) - 1

    def part(self, steps: int) -> Block:
        """Return the first steps."""
        slopes = None if self.slopes is None else self.slopes[:steps]
        return Block(self.t[: steps + 1], self.y[: steps + 1], slopes)


@dataclass
class Counts:
    """What an integration took so far; all members of an ensemble that moves as one count once.

    Attributes
    ----------
    nfev, nexp, njev, nlu
        Evaluations of ``f``, flows, Jacobians of the stage equations and inversions of them.
    steps, rejected
        Accepted and rejected steps.
    """

    nfev: int = 0
    nexp: int = 0
    njev: int = 0
    nlu: int = 0
    steps: int = 0
    rejected: int = 0

    def add(self, others: Counts) -> None:
        """Add what others took."""
        for part in fields(self):
            setattr(self, part.name, getattr(self, part.name) + getattr(others, part.name))


@dataclass
class Stepper(ABC):
    """Takes the steps of one integration.

    Attributes
    ----------
    frame
        The frame that holds the points and supplies the flows.
    method
        The method.
    batch
        Leading axes of the points.
    counts
        What it took so far.
    trouble
        Why the steps ended before the end was reached, empty if they didn't.
    failures
        Why members of an ensemble ended early, by their indices.
    """

    frame: Frame
    method: Method
    batch: tuple[int, ...]
    counts: Counts = field(default_factory=Counts, init=False)
    trouble: str = field(default="", init=False)
    failures: dict[tuple[int, ...], str] = field(default_factory=dict, init=False)

    @property
    def whole(self) -> tuple[Array, Points] | None:
        """Times and points of all steps so far, of which blocks are parts; None if apart."""
        return None

    @abstractmethod
    def blocks(self) -> Iterator[Block]:
        """Give the steps, one block after the other; an error of ``f`` is raised here."""

    @abstractmethod
    def last_slope(self) -> Array:
        """Return the coefficients at the end of the last block, shape ``(*batch, dim)``."""

    @abstractmethod
    def evaluate(self, t: Array, y: Points) -> Array:
        """Return coefficients at times ``(n,)`` and points ``(n, *batch, *point_shape)``."""

    @abstractmethod
    def end_member(self, index: tuple[int, ...]) -> None:
        """Take no more steps of one member of an ensemble: it stays where it is."""


def advances_by_embedded(method: Method) -> bool:
    """Tell whether the second result of a pair is of higher order, and makes the steps."""
    embedded = method.embedded_order
    return embedded is not None and embedded > method.order


def error_exponent(method: Method) -> float:
    """Return the power of an error that a step is proportional to, by the order of a pair."""
    if method.third_order is not None:
        advancing = method.advancing if isinstance(method, MuntheKaas) else method
        second, third = advancing.embedded_order or 0, method.third_order
        return 1.0 / max(2 * (second + 1) - (third + 1), 1)
    orders = method.order, method.embedded_order
    return 1.0 / (min(order for order in orders if order is not None) + 1)

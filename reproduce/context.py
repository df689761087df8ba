"""What an item is given: the settings of the run and the results so far."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

from cg.support.parallel import available_cores

from .blocks import Data

__all__ = ["Context", "Progress", "Settings"]

Progress = Callable[[int, int], None]
"""Called with the numbers of finished and of all parts of an item."""


@dataclass(frozen=True)
class Settings:
    """What determines the numbers of a run.

    Attributes
    ----------
    seed : int
        Seed of all random starts.
    full : bool
        Search extensively.
    """

    seed: int = 0
    full: bool = False

    def __str__(self) -> str:
        return f"seed {self.seed}, {'extensive' if self.full else 'default'} search"


@dataclass(frozen=True)
class Context:
    """Settings, resources and earlier results.

    Attributes
    ----------
    settings : Settings
    checkpoints : Path
        Folder for what a killed run should keep.
    workers : int
        Threads.
    progress : callable
    publish : callable
        Receives what an item has so far, in the form of its result, and shows it as partial.
    limit : float or None
        Seconds that an item with random starts may search; what it has by then is its result.
    results : mapping
        Numbers of the items that this one needs, by name.
    """

    settings: Settings
    checkpoints: Path
    workers: int = field(default_factory=available_cores)
    progress: Progress = lambda done, total: None
    publish: Callable[[Data], None] = lambda numbers: None
    limit: float | None = None
    results: Mapping[str, Data] = field(default_factory=dict)

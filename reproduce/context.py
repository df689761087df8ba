"""The input of an item: settings of the run, resources, and earlier results."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

from cg.support.parallel import available_cores

from .blocks import Data

Progress = Callable[[int, int], None]
"""Function of the numbers of finished and of all parts of an item."""


@dataclass(frozen=True)
class Settings:
    """Settings that determine the numbers of a run.

    `seed` is that of all random starts; `full` searches extensively.
    """

    seed: int = 0
    full: bool = False

    def __str__(self) -> str:
        return f"seed {self.seed}, {'extensive' if self.full else 'default'} search"


@dataclass(frozen=True)
class Context:
    """Settings, resources and earlier results.

    `checkpoints` is the folder for files from which a killed run continues, `workers` a number of
    threads or processes. `publish` shows an intermediate result of an item as partial; `limit` are
    the seconds after which a search ends with the result so far. `results` has by name the data of
    the items that this one needs.
    """

    settings: Settings
    checkpoints: Path
    workers: int = field(default_factory=available_cores)
    progress: Progress = lambda done, total: None
    publish: Callable[[Data], None] = lambda numbers: None
    limit: float | None = None
    results: Mapping[str, Data] = field(default_factory=dict)

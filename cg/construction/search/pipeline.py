"""What `cg.search` and `cg.construct` share: checks of arguments, and runs of starts."""

from __future__ import annotations

from collections.abc import Callable, Generator
from dataclasses import dataclass
from functools import partial
from typing import Any, TypeVar

from cg.construction.runs.long_run import RunOptions, Score, run_pieces
from cg.construction.search.requirements import Requirements
from cg.construction.search.settings import Settings
from cg.support import quads
from cg.support.checks import MAX_COUNT, check_integer

Start = TypeVar("Start")


@dataclass(frozen=True)
class Pipeline:
    """Random starts, each determined by the settings and its number, and what is required."""

    settings: Settings
    total: int
    options: RunOptions
    requirements: Requirements

    @classmethod
    def checked(
        cls,
        settings: Settings,
        total: tuple[str, Any],
        requirements: tuple[Any, Any, Any],
        options: tuple[Any, Any, Any, Any],
    ) -> Pipeline:
        """Return the pipeline of arguments: of `Requirements` and of `RunOptions`, in order."""
        quads.core(f"cg.{settings.kind}")
        return cls(
            settings,
            check_integer(*total, 1, MAX_COUNT),
            RunOptions.checked(*options),
            Requirements.checked(settings.order, *requirements),
        )

    def run(
        self,
        work: Callable[[Settings, int], Start],
        read: Callable[[dict[str, Any]], Start],
        score: Callable[[Start], Score],
    ) -> Generator[Start, None, None]:
        """Yield the starts as they finish, after those that the store has; see `run_pieces`."""
        settings = self.settings
        piece = partial(work, settings)
        return run_pieces(settings, piece, self.total, self.options, read=read, score=score)

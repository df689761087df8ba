"""Long runs: numbered pieces of work on an executor, with a store and a progress bar."""

from __future__ import annotations

import os
from collections.abc import Callable, Generator, Iterator
from concurrent.futures import BrokenExecutor
from contextlib import ExitStack, closing, contextmanager
from dataclasses import asdict, dataclass
from typing import Any, NamedTuple, TypeVar

from cg.construction.runs.store import Store, StoreError
from cg.support.executors import ExecutorLike, check_executor, completed
from cg.support.progress import make_bar

Result = TypeVar("Result")

_NOUNS = {"search": ("search", "start"), "construct": ("construction", "try")}
"""What kinds of runs and their pieces are called."""


class Score(NamedTuple):
    """How good the result of a piece is."""

    f: float  # sum of squared residuals
    solved: bool


@dataclass(frozen=True)
class RunOptions:
    """How a long run is carried out, which doesn't change results."""

    workers: int | None
    executor: ExecutorLike
    store: str | os.PathLike[str] | None
    progress: Callable[[int, int], None] | None
    bar: bool

    @classmethod
    def checked(
        cls,
        workers: int | None,
        executor: ExecutorLike,
        store: str | os.PathLike[str] | None,
        progress: Callable[[int, int], None] | bool | None,
    ) -> RunOptions:
        """Return the options of a run, checked, except the store, which is opened later."""
        if not (progress is None or isinstance(progress, bool) or callable(progress)):
            raise TypeError(f"progress must be callable, got {progress!r}; True asks for a bar")
        call = progress if callable(progress) else None
        return cls(*check_executor(executor, workers)[::-1], store, call, progress is True)


def run_pieces(
    settings: Any,
    work: Callable[[int], Result],
    total: int,
    options: RunOptions,
    *,
    read: Callable[[dict[str, Any]], Result],
    score: Callable[[Result], Score],
) -> Generator[Result, None, None]:
    """Yield the results of pieces: those that the store has, then each after it was stored.

    A piece is a function of the `settings`, a dataclass with a ``kind``, and of its number. Results
    are dataclasses with the number as ``index``, which `read` makes of the dict of their fields.
    """
    with ExitStack() as stack:
        store, known = None, {}
        if options.store is not None:
            store = Store(options.store, asdict(settings))
            stack.enter_context(closing(store))
            known = {k: each for k, each in _known(store, read).items() if k < total}
        count = stack.enter_context(_counted(options, _NOUNS[settings.kind][1], total, len(known)))
        for result in known.values():
            count(score(result), False)
            yield result
        stack.enter_context(_how_to_continue(options.store, _NOUNS[settings.kind][0]))
        numbers = (number for number in range(total) if number not in known)
        running = completed(
            work, numbers, options.executor, options.workers, finish=store is not None
        )
        for done, (_, result) in enumerate(stack.enter_context(closing(running)), len(known) + 1):
            if store is not None:
                store.append(asdict(result))  # type: ignore[call-overload]
            count(score(result), True)
            if options.progress is not None:
                options.progress(done, total)
            yield result


def _known(store: Store, read: Callable[[dict[str, Any]], Result]) -> dict[int, Result]:
    """Return the results in a store by their numbers, in order."""
    try:
        return {number: read(fields) for number, fields in sorted(store.pieces().items())}
    except (KeyError, TypeError) as error:
        raise StoreError(
            f"store {store.path} was written by another version of this package: {error!r}"
        ) from error


@contextmanager
def _counted(
    options: RunOptions, piece: str, total: int, known: int
) -> Iterator[Callable[[Score, bool], None]]:
    """Yield a function that counts a result, new or stored, and shows it on the bar."""
    if not options.bar:
        yield lambda score, new: None
        return
    best, solved = float("inf"), 0
    with make_bar(total=total, initial=known, unit=piece) as bar:

        def count(score: Score, new: bool) -> None:
            nonlocal best, solved
            best, solved = min(best, score.f), solved + score.solved
            bar.set_postfix_str(f"{solved} solved, smallest f {best:.1e}", refresh=False)
            bar.update(int(new))

        yield count


@contextmanager
def _how_to_continue(path: str | os.PathLike[str] | None, kind: str) -> Iterator[None]:
    """Add to errors that end a run how to resume it."""
    try:
        yield
    except (KeyboardInterrupt, BrokenExecutor, OSError) as error:
        if path is not None:
            error.add_note(
                f"finished results are in {os.fspath(path)}; run the same {kind} again to "
                "continue, on any executor"
            )
        raise

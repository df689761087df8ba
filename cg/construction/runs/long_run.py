"""Long runs: numbered pieces of work on an executor, with a store and a progress line."""

from __future__ import annotations

import os
from collections.abc import Callable, Generator, Iterator, Mapping
from concurrent.futures import BrokenExecutor
from contextlib import ExitStack, closing, contextmanager
from dataclasses import asdict, dataclass
from typing import Any, Generic, TypeVar

from cg.construction.runs.entries import Failure, StoredStart
from cg.construction.runs.one_run import StoredRun
from cg.construction.runs.progress import ProgressLine, Score, Tally
from cg.construction.runs.store import Store
from cg.executors import ExecutorLike, check_executor, completed

Result = TypeVar("Result")

_NOUNS = {"search": ("search", "starts"), "construct": ("construction", "tries")}
"""What kinds of runs and their pieces are called in messages."""


@dataclass(frozen=True)
class RunOptions:
    """How a long run is carried out, which doesn't change results; `line` shows the progress."""

    workers: int | None
    executor: ExecutorLike
    store: str | os.PathLike[str] | None
    progress: Callable[[int, int], None] | None
    line: ProgressLine | None

    @classmethod
    def checked(
        cls,
        workers: int | None,
        executor: ExecutorLike,
        store: str | os.PathLike[str] | None,
        progress: Callable[[int, int], None] | ProgressLine | bool | None,
    ) -> RunOptions:
        """Return the options of a run, checked, except the store, which is opened later."""
        line = ProgressLine() if progress is True else None
        if isinstance(progress, ProgressLine):
            line = progress
        elif not (progress is None or isinstance(progress, bool) or callable(progress)):
            raise TypeError(
                f"progress must be callable, got {progress!r}; True asks for a line on standard "
                "error"
            )
        call = progress if callable(progress) else None
        return cls(*check_executor(executor, workers)[::-1], store, call, line)


@dataclass(frozen=True)
class LongRun(Generic[Result]):
    """Pieces of work numbered from 0, each a function of the settings and its number."""

    kind: str  # "search" or "construct"
    settings: Any  # a dataclass of plain data that determines the results
    work: Callable[[int], Result]  # picklable for executors other than threads
    to_entry: Callable[[Result, float], StoredStart]  # takes the seconds that the piece took
    from_entry: Callable[[StoredStart], Result]  # raises ValueError for a wrong entry
    score: Callable[[Result], Score]

    @contextmanager
    def running(
        self, total: int, options: RunOptions
    ) -> Iterator[tuple[StoredRun | None, Iterator[tuple[int, Result | Failure]]]]:
        """Open the store and yield its run, and an iterator over numbers and results.

        The iterator yields what the store has, then every piece as it finishes and after storing
        it.
        """
        with ExitStack() as stack:
            stored = None
            if options.store is not None:
                run = stored_run(options.store, self.kind, asdict(self.settings))
                stored = stack.enter_context(run)
            results = self._results(total, options, stored)
            yield stored, stack.enter_context(closing(results))

    def _results(
        self, total: int, options: RunOptions, stored: StoredRun | None
    ) -> Generator[tuple[int, Result | Failure], None, None]:
        tally = Tally(options.line, _NOUNS[self.kind][1], total)
        known = bytearray(total)
        for number, result in self._known(stored):
            if number < total:
                known[number] = 1
                tally.count(self._score(result))
                yield number, result
        running = completed(
            self.work,
            (number for number in range(total) if not known[number]),
            total - sum(known),
            options.workers,
            options.executor,
            finish_on_interrupt=stored is not None,
        )
        with closing(running), tally:
            for finished in running:
                failure = Failure(finished.index, str(finished.failure))
                result = failure if finished.result is None else finished.result
                if stored is not None:
                    self._store(stored, result, finished.seconds)
                tally.report(self._score(result))
                if options.progress:
                    options.progress(tally.done, total)
                yield finished.index, result

    def _store(self, stored: StoredRun, result: Result | Failure, seconds: float) -> None:
        if isinstance(result, Failure):
            stored.fail(result)
        else:
            stored.append([self.to_entry(result, seconds)])

    def _score(self, result: Result | Failure) -> Score | None:
        return None if isinstance(result, Failure) else self.score(result)

    def _known(self, stored: StoredRun | None) -> Iterator[tuple[int, Result | Failure]]:
        """Yield the numbers and results that a store has."""
        if stored is not None:
            # the traceback of a wrong entry must not keep the file open
            with closing(stored.entries()) as entries:
                for entry in entries:
                    yield entry.number, self.from_entry(entry)
            yield from ((failure.index, failure) for failure in stored.failures())


@contextmanager
def stored_run(
    path: str | os.PathLike[str], kind: str, settings: Mapping[str, Any]
) -> Iterator[StoredRun]:
    """Begin or resume a run of a store; add to errors that end it how to resume it."""
    with Store(path) as store, closing(store.begin(kind, settings)) as run:
        try:
            yield run
        except (KeyboardInterrupt, BrokenExecutor, OSError) as error:
            error.add_note(
                f"finished results are in {os.fspath(path)}; run the same {_NOUNS[kind][0]} again "
                "to continue, on any executor"
            )
            raise

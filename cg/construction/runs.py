"""Long runs: numbered pieces of work on an executor, with a store and a progress bar.

The store keeps the finished pieces in a file: JSON, one object a line. A line is one write at the
end of the file. So a process that is killed leaves at most its last line incomplete, and runs of
several processes can share a file. Two processes with the same run repeat each other's work: pieces
depend on their numbers alone. Each line begins with ``run``, a digest of the settings, which the
first line of a run has, and ends with a checksum. Incomplete and damaged lines are ignored, and
their pieces run again.
"""

from __future__ import annotations

import errno
import hashlib
import json
import logging
import os
import zlib
from collections.abc import Callable, Generator, Iterator, Mapping
from concurrent.futures import BrokenExecutor
from contextlib import ExitStack, closing, contextmanager, suppress
from dataclasses import asdict
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from cg import __version__
from cg.support.parallel import ExecutorLike, check_executor, completed, make_bar

_BEGIN = b'{"run": "'
_SUM = b', "crc": '  # before the checksum at the end of a line

_log = logging.getLogger("cg")

Result = TypeVar("Result")

_NOUNS = {"search": ("search", "start"), "construct": ("construction", "try")}
"""Names of kinds of runs and of their pieces."""


class StoreError(ValueError):
    """A file that isn't a store."""


def check_store_path(value: Any) -> Path:
    """Return the path of a store; raise an error if it can't be one."""
    if not isinstance(value, str | os.PathLike):
        raise TypeError(f"store must be a path, got {value!r}")
    path = Path(value)
    if not path.parent.is_dir():
        raise FileNotFoundError(f"store must be in an existing folder, got {str(path)!r}")
    # reading from a device or a pipe may never end
    if path.exists() and not (path.is_file() or path.is_dir()):
        raise ValueError(f"store must be a file, got {path}, which isn't a regular file")
    return path


def read_store(path: str | os.PathLike[str], run: str = "") -> Iterator[dict[str, Any]]:
    """Yield the lines of a store, of all runs or of one; StoreError if the file isn't one."""
    begin, damaged = _BEGIN + run.encode(), 0
    with check_store_path(path).open("rb") as file:
        for number, line in enumerate(file):
            if number == 0 and not line.startswith(_BEGIN):
                raise StoreError(f"store {path} isn't a file of runs of this package")
            if not line.startswith(begin):
                damaged += not line.startswith(_BEGIN)
                continue
            body, _, rest = line.rpartition(_SUM)
            entry = None
            if rest == b"%d}\n" % zlib.crc32(body):
                with suppress(ValueError, RecursionError):
                    entry = json.loads(body + b"}")
            damaged += entry is None
            if entry is not None:
                yield entry
    if damaged:
        _log.warning("%d lines of the store %s are damaged, and ignored", damaged, path)


class Store:
    """One run in a file, which is made if there is none."""

    def __init__(self, path: str | os.PathLike[str], settings: Mapping[str, Any]) -> None:
        self.path = check_store_path(path)
        # empty ones are left out, so that a new setting doesn't change the runs that lack it
        known = {name: value for name, value in settings.items() if value != ()}
        text = json.dumps(known, sort_keys=True)
        self.run = hashlib.sha256(text.encode()).hexdigest()[:16]
        self._file = self.path.open("ab+", buffering=0)
        try:
            begun = any("settings" in line for line in read_store(self.path, self.run))
            size = self._file.seek(0, os.SEEK_END)
            if size and (self._file.seek(size - 1), self._file.read(1)) != (size - 1, b"\n"):
                self._file.write(b"\n")  # after a line that a killed process left incomplete
            if not begun:
                versions = {"crouch-grossman": __version__, "numpy": np.__version__}
                self.append({"settings": known, "versions": versions})
        except BaseException:
            self._file.close()
            raise

    def results(self, read: Callable[[dict[str, Any]], Result]) -> dict[int, Result]:
        """Return the results of finished pieces by their numbers; `read` makes them of fields."""
        lines = read_store(self.path, self.run)
        pieces = {line["index"]: line for line in lines if line.pop("run") and "index" in line}
        try:
            return {number: read(pieces[number]) for number in sorted(pieces)}
        except (KeyError, TypeError) as error:
            raise StoreError(
                f"store {self.path} was written by another version of this package: {error!r}"
            ) from error

    def append(self, line: Mapping[str, Any]) -> None:
        """Store the settings, or a finished piece, which has an ``index``."""
        body = json.dumps({"run": self.run, **line})[:-1].encode()
        data = body + _SUM + b"%d}\n" % zlib.crc32(body)
        if self._file.write(data) != len(data):
            raise OSError(errno.ENOSPC, "store can't be written", str(self.path))

    def close(self) -> None:
        """Write everything to the disk and close the file."""
        os.fsync(self._file.fileno())
        self._file.close()


def run_pieces(
    settings: Any, work: Callable[[int], Result], total: int, *,
    read: Callable[[dict[str, Any]], Result], solved: Callable[[Result], bool], workers: int | None,
    executor: ExecutorLike, store: str | os.PathLike[str] | None,
    progress: Callable[[int, int], None] | bool | None,
) -> Generator[Result, None, None]:  # fmt: skip
    """Yield the results of pieces: those that the store has, then each after it was stored.

    A piece is a function of the `settings`, a dataclass with a ``kind``, and of its number. Results
    are dataclasses with the number as ``index`` and the sum of squared residuals ``f``, which
    `read` makes of the dict of their fields; `solved` tells which ones a bar counts.
    """
    if not (progress is None or isinstance(progress, bool) or callable(progress)):
        raise TypeError(f"progress must be callable, got {progress!r}; True asks for a bar")
    executor, workers = check_executor(executor, workers)
    with ExitStack() as stack:
        file, known = None, {}
        if store is not None:
            file = stack.enter_context(closing(Store(store, asdict(settings))))
            known = {k: each for k, each in file.results(read).items() if k < total}
        run, piece = _NOUNS[settings.kind]
        count = stack.enter_context(_counted(progress, piece, total, len(known), solved))
        for result in known.values():
            count(result, False)
            yield result
        if known and callable(progress):
            progress(len(known), total)
        stack.enter_context(_how_to_continue(store, run))
        numbers = (number for number in range(total) if number not in known)
        running = completed(work, numbers, executor, workers, finish=file is not None)
        for done, (_, result) in enumerate(stack.enter_context(closing(running)), len(known) + 1):
            if file is not None:
                file.append(asdict(result))  # type: ignore[call-overload]
            count(result, True)
            if callable(progress):
                progress(done, total)
            yield result


@contextmanager
def _counted(
    progress: Any, piece: str, total: int, known: int, solved: Callable[[Any], bool]
) -> Iterator[Callable[[Any, bool], None]]:
    """Yield a function that counts a result, new or stored, and shows it on a bar if asked to."""
    if progress is not True:
        yield lambda result, new: None
        return
    best, number = float("inf"), 0
    with make_bar(total=total, initial=known, unit=piece) as bar:

        def count(result: Any, new: bool) -> None:
            nonlocal best, number
            best, number = min(best, result.f), number + solved(result)
            bar.set_postfix_str(f"{number} solved, smallest f {best:.1e}", refresh=False)
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

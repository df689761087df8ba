"""The file of a store: paths, connections, write-ahead logging and errors.

While a store is open, SQLite writes to a log beside it, with ``-wal`` at the end of its name. It
moves the log into the file when the last connection closes, but not if two connections close at
the same moment or the last one is read-only. `fold_log` moves it in these cases.
"""

import errno
import logging
import os
import sqlite3
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any

_BUSY_SECONDS = 60  # that a writer waits for another
_FOLD_SECONDS = 5  # that the end of a run waits for readers

_log = logging.getLogger("cg")


class StoreError(ValueError):
    """A file that isn't a store, is damaged, or was written by another version."""


def check_path(value: Any) -> Path:
    """Return the path of a store; raise an error if it can't be one."""
    if not isinstance(value, str | os.PathLike):
        raise TypeError(f"store must be a path, got {value!r}")
    path = Path(value)
    try:
        encoded = os.fsencode(path)
    except UnicodeEncodeError:
        encoded = b"\0"
    if b"\0" in encoded:
        raise ValueError(f"store must be a path that the system can write, got {value!r}")
    if path.is_dir():
        raise IsADirectoryError(errno.EISDIR, "store must be a file", str(path))
    # reading from a device or a pipe may never end
    if path.exists() and not path.is_file():
        raise ValueError(f"store must be a file, got {path}, which isn't a regular file")
    if not path.parent.is_dir():
        raise FileNotFoundError(errno.ENOENT, "store must be in an existing folder", str(path))
    return path


def connect(path: Path, options: str = "", seconds: float = _BUSY_SECONDS) -> sqlite3.Connection:
    """Return a connection that waits for other writers for a number of seconds."""
    # as a URI, since SQLite gives some names a special meaning
    return sqlite3.connect(
        path.absolute().as_uri() + options, timeout=seconds, isolation_level=None, uri=True
    )


def use_wal(connection: sqlite3.Connection) -> None:
    """Turn on write-ahead logging; SQLite's own waiting doesn't cover this statement."""
    until = time.monotonic() + _BUSY_SECONDS
    while True:
        try:
            connection.execute("PRAGMA journal_mode = WAL")
            return
        except sqlite3.OperationalError as error:
            if not _is_busy(error) or time.monotonic() > until:
                raise
        time.sleep(0.01)


def _is_busy(error: sqlite3.DatabaseError) -> bool:
    return getattr(error, "sqlite_errorcode", 0) & 0xFF == sqlite3.SQLITE_BUSY


def log_path(path: Path) -> Path:
    """Return the path of the log of a store."""
    return path.with_name(path.name + "-wal")


def has_log(path: Path) -> bool:
    """Return whether a store has a log that isn't empty."""
    try:
        return log_path(path).stat().st_size > 0
    except FileNotFoundError:
        return False


def fold_log(path: Path) -> None:
    """Move the log of a store into its file; warn if other connections prevent it."""
    until = time.monotonic() + _FOLD_SECONDS
    while has_log(path):
        try:
            with closing(connect(path, "?mode=rw", 0.1)) as connection:
                (busy, *_) = connection.execute("PRAGMA wal_checkpoint(TRUNCATE)").fetchone()
            reason = "other connections are open" if busy else ""
        except sqlite3.DatabaseError as error:
            busy, reason = _is_busy(error), str(error)
        if not reason:
            return
        if not busy or time.monotonic() > until:
            _log.warning(
                "part of the store %s is still in its log %s (%s): keep both files together until "
                "the store is next opened for writing",
                path, log_path(path).name, reason,
            )  # fmt: skip
            return
        time.sleep(0.01)  # SQLite doesn't wait for another process that folds the log


@contextmanager
def sqlite_errors(path: Path) -> Iterator[None]:
    """Turn errors of SQLite into `StoreError` and OSError with the path."""
    try:
        yield
    except sqlite3.DatabaseError as error:
        name = getattr(error, "sqlite_errorname", "")
        if name.startswith(("SQLITE_NOTADB", "SQLITE_CORRUPT")):
            raise StoreError(
                f"store {path} is not an SQLite database, or damaged: {error}"
            ) from error
        number = {
            "SQLITE_FULL": errno.ENOSPC,
            "SQLITE_READONLY": errno.EROFS,
            "SQLITE_CANTOPEN": errno.EACCES,
            "SQLITE_BUSY": errno.EAGAIN,
        }.get("_".join(name.split("_")[:2]), errno.EIO)
        raise OSError(number, f"store can't be used: {error}", str(path)) from error


@contextmanager
def transaction(connection: sqlite3.Connection, path: Path) -> Iterator[None]:
    """Commit the changes of a block, or none of them if it raises an exception."""
    with sqlite_errors(path):
        try:  # an interrupt may come between any two of these statements
            connection.execute("BEGIN IMMEDIATE")
            yield
            connection.execute("COMMIT")
        except BaseException:
            if connection.in_transaction:
                connection.execute("ROLLBACK")
            raise

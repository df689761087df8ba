"""The file of a store: how it is opened, folded and refused.

A file at work has a log beside it, ``-wal``, which SQLite folds into the file when the last
connection closes; not if two close at the same moment, and not if the last one only reads.
"""

from __future__ import annotations

import errno
import logging
import os
import sqlite3
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any

__all__ = [
    "StoreError", "change_to_wal", "checked", "connected", "fold_log", "has_log", "log_of",
    "named_errors",
]  # fmt: skip

_BUSY_SECONDS = 60  # for which a writer waits for another
_FOLD_SECONDS = 5  # for which a run that ends waits for those that read

_log = logging.getLogger("cg")


class StoreError(ValueError):
    """A file that is no store, or is damaged, or was written by a newer version."""


def checked(given: Any) -> Path:
    """Return the path of a store, or raise an error if it can't be one."""
    if not isinstance(given, str | os.PathLike):
        raise TypeError(f"store must be a path, got {given!r}")
    path = Path(given)
    try:
        encoded = os.fsencode(path)
    except UnicodeEncodeError:
        encoded = b"\0"
    if b"\0" in encoded:
        raise ValueError(f"store must be a path that the system can write, got {given!r}")
    if path.is_dir():
        raise IsADirectoryError(errno.EISDIR, "store must be a file", str(path))
    # a device or a pipe may never end
    if path.exists() and not path.is_file():
        raise ValueError(f"store must be a file, got {path}, which exists and is none")
    if not path.parent.is_dir():
        raise FileNotFoundError(errno.ENOENT, "store must be in a folder that exists", str(path))
    return path


def connected(path: Path, options: str = "", seconds: float = _BUSY_SECONDS) -> sqlite3.Connection:
    """Return a connection, which waits so long for others that write."""
    # as an address, since SQLite takes some names for something else than files
    return sqlite3.connect(
        path.absolute().as_uri() + options, timeout=seconds, isolation_level=None, uri=True
    )


def change_to_wal(connection: sqlite3.Connection) -> None:
    """Turn on write-ahead logging, for which SQLite itself waits for no other process."""
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


def log_of(path: Path) -> Path:
    """Return the path of the log of a store."""
    return path.with_name(path.name + "-wal")


def has_log(path: Path) -> bool:
    """Return whether a log with something in it is beside a store."""
    try:
        return log_of(path).stat().st_size > 0
    except FileNotFoundError:
        return False


def fold_log(path: Path) -> None:
    """Move what is in the log of a store into its file, and warn if others don't let it."""
    until = time.monotonic() + _FOLD_SECONDS
    while has_log(path):
        try:
            with closing(connected(path, "?mode=rw", 0.1)) as connection:
                (busy, *_) = connection.execute("PRAGMA wal_checkpoint(TRUNCATE)").fetchone()
            reason = "others are at work on it" if busy else ""
        except sqlite3.DatabaseError as error:
            busy, reason = _is_busy(error), str(error)
        if not reason:
            return
        if not busy or time.monotonic() > until:
            _log.warning(
                "part of the store %s is still in its log %s (%s): keep both files together until "
                "the store has been opened again to write",
                path, log_of(path).name, reason,
            )  # fmt: skip
            return
        time.sleep(0.01)  # SQLite itself doesn't wait for another process that folds


@contextmanager
def named_errors(path: Path) -> Iterator[None]:
    """Turn errors of SQLite into those of files, with the path."""
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

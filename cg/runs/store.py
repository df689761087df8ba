"""A file that keeps what long runs have found: an SQLite database that runs share.

A killed run loses nothing that it had recorded; a run with the same settings goes on from there.
Runs with other settings may use the same file, at the same time and from other processes of the
same machine.
"""

from __future__ import annotations

import errno
import json
import math
import os
import platform
import sqlite3
import time
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import astuple, fields
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from .owner import AT_WORK, alive, owner
from .records import Failure, Record, RunSummary
from .schema import APPLICATION_ID, MIGRATIONS

__all__ = ["Store", "StoreError", "StoredRun"]

_BUSY_SECONDS = 60  # for which a writer waits for another


_COLUMNS = tuple(field.name for field in fields(Record))
_INSERT = (
    f"INSERT OR REPLACE INTO starts (run, finished, {', '.join(_COLUMNS)}) "
    f"VALUES ({', '.join('?' * (len(_COLUMNS) + 2))})"
)
_SELECT = f"SELECT {', '.join(_COLUMNS)} FROM starts WHERE run = ?"


class StoreError(ValueError):
    """A file that is no store, or is damaged, or was written by a newer version."""


class Store:
    """An open store; also a context manager that closes it.

    Parameters
    ----------
    path : path
        The file, which is made if there is none.
    read : bool, optional
        Only read from a file, which must be there; it isn't changed.

    Raises
    ------
    TypeError
        If it isn't a path.
    ValueError
        If it isn't a file, no store, or written by a newer version.
    OSError
        If it can't be written, or read.

    Examples
    --------
    >>> import tempfile, cg
    >>> path = Path(tempfile.mkdtemp()) / "runs.db"
    >>> _ = cg.search(order=2, stages=2, starts=3, seed=1, store=path)
    >>> with Store(path) as store:
    ...     [(run.kind, run.starts, run.solved) for run in store.runs()]
    [('search', 3, 3)]
    """

    def __init__(self, path: str | os.PathLike[str], *, read: bool = False) -> None:
        self.path = _checked(path)
        if read and not self.path.exists():
            raise FileNotFoundError(errno.ENOENT, "store must be a file that exists", str(path))
        with _named_errors(self.path):
            self._connection = self._connected("?mode=ro" if read else "")
            try:
                if read:
                    self._check_to_read()
                else:
                    self._migrate()
            except BaseException:
                self._connection.close()
                raise

    def _connected(self, options: str) -> sqlite3.Connection:
        # as an address, since SQLite takes some names for something else than files
        return sqlite3.connect(
            self.path.absolute().as_uri() + options,
            timeout=_BUSY_SECONDS, isolation_level=None, uri=True,
        )  # fmt: skip

    def _check_to_read(self) -> None:
        """Raise ValueError unless the file can be read as it is; an older store is brought up."""
        try:
            self._connection.execute("SELECT count(*) FROM sqlite_master").fetchone()
        except sqlite3.OperationalError:
            # beside a file in a folder that can't be written there can't be what readers share
            self._connection.close()
            self._connection = self._connected("?mode=ro&immutable=1")
        known, tables = self._contents()
        if known != APPLICATION_ID or not tables:
            raise StoreError(f"store {self.path} is no store")
        if self._schema() != len(MIGRATIONS):
            self._connection.close()
            self._connection = self._connected("")
            self._migrate()

    def _contents(self) -> tuple[int, int]:
        """Return which program made the file, and the number of its tables."""
        connection = self._connection
        connection.execute("BEGIN")  # both of the same moment: another process may be making it
        (known,) = connection.execute("PRAGMA application_id").fetchone()
        (tables,) = connection.execute("SELECT count(*) FROM sqlite_master").fetchone()
        connection.execute("COMMIT")
        return int(known), int(tables)

    def __enter__(self) -> Store:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the file."""
        self._connection.close()

    def _migrate(self) -> None:
        """Bring an older store, or an empty file, to the present schema."""
        connection = self._connection
        known, tables = self._contents()
        if known != APPLICATION_ID and (known or tables):
            raise StoreError(f"store {self.path} is a database of another program")
        if self._schema() > len(MIGRATIONS):
            raise StoreError(
                f"store {self.path} was written by a newer version of this package: schema "
                f"{self._schema()}, this version knows {len(MIGRATIONS)}"
            )
        self._change_to_wal()
        connection.execute("PRAGMA synchronous = NORMAL")
        connection.execute("PRAGMA foreign_keys = ON")
        if self._schema() == len(MIGRATIONS):
            return
        with self._transaction():
            for number, statements in enumerate(MIGRATIONS[self._schema() :], self._schema() + 1):
                for statement in statements:
                    connection.execute(statement)
                connection.execute(f"PRAGMA user_version = {number}")
            connection.execute(f"PRAGMA application_id = {APPLICATION_ID}")

    def _change_to_wal(self) -> None:
        """Turn on write-ahead logging, for which SQLite itself waits for no other process."""
        until = time.monotonic() + _BUSY_SECONDS
        while True:
            try:
                self._connection.execute("PRAGMA journal_mode = WAL")
                return
            except sqlite3.OperationalError as error:
                busy = error.sqlite_errorcode & 0xFF == sqlite3.SQLITE_BUSY
                if not busy or time.monotonic() > until:
                    raise
            time.sleep(0.01)

    def _schema(self) -> int:
        (number,) = self._connection.execute("PRAGMA user_version").fetchone()
        return int(number)

    @contextmanager
    def _transaction(self) -> Iterator[None]:
        with _named_errors(self.path):
            try:  # an interrupt may come between any two of these
                self._connection.execute("BEGIN IMMEDIATE")
                yield
                self._connection.execute("COMMIT")
            except BaseException:
                if self._connection.in_transaction:
                    self._connection.execute("ROLLBACK")
                raise

    def begin(self, kind: str, settings: Mapping[str, Any]) -> StoredRun:
        """Begin a run, or go on with the one of the same settings.

        Parameters
        ----------
        kind : str
        settings : mapping
            What determines the results, as plain data.

        Raises
        ------
        OSError
            If a process that lives is at work on the same run.
        """
        text = _canonical(settings)
        connection, me = self._connection, owner()
        with self._transaction():
            row = connection.execute(
                "SELECT number, owner, changed FROM runs WHERE kind = ? AND settings = ?",
                (kind, text),
            ).fetchone()
            now = time.time()
            if row is None:
                number = connection.execute(
                    "INSERT INTO runs (kind, settings, versions, created, changed, owner) "
                    "VALUES (?, ?, ?, ?, ?, ?)",
                    (kind, text, json.dumps(_versions()), now, now, me),
                ).lastrowid
            else:
                number, other, changed = row
                if other is not None and alive(other, changed):
                    raise BlockingIOError(
                        errno.EAGAIN,
                        f"the run is in use by process {json.loads(other)['process']}, "
                        "which has the same settings",
                        str(self.path),
                    )
                connection.execute(
                    "UPDATE runs SET owner = ?, changed = ? WHERE number = ?", (me, now, number)
                )
        assert number is not None
        AT_WORK.add(me)
        return StoredRun(self, int(number), me)

    def run(self, number: int) -> StoredRun:
        """Return a run to read from.

        Raises
        ------
        KeyError
            If there is none of that number; the message lists those that there are.
        """
        numbers = [found for (found,) in self._connection.execute("SELECT number FROM runs")]
        if number not in numbers:
            raise KeyError(f"no run {number!r} in {self.path}; there are {numbers}")
        return StoredRun(self, number, None)

    def runs(self) -> tuple[RunSummary, ...]:
        """Return all runs, in the order in which they were begun."""
        with _named_errors(self.path):
            rows = self._connection.execute(
                """
                SELECT runs.number, kind, settings, versions, created, changed, owner,
                    count(starts.number), coalesce(sum(solved), 0),
                    (SELECT count(*) FROM failures WHERE failures.run = runs.number),
                    min(coalesce(refined_f, f)), coalesce(sum(seconds), 0.0)
                FROM runs LEFT JOIN starts ON starts.run = runs.number
                GROUP BY runs.number ORDER BY runs.number
                """
            ).fetchall()
        return tuple(_summary(*row) for row in rows)


def _summary(
    number: int,
    kind: str,
    settings: str,
    versions: str,
    created: float,
    changed: float,
    owner: str | None,
    starts: int,
    solved: int,
    failed: int,
    best: float | None,
    seconds: float,
) -> RunSummary:
    return RunSummary(
        number,
        kind,
        json.loads(settings),
        json.loads(versions),
        created,
        changed,
        starts,
        solved,
        failed,
        best,
        seconds,
        owner is not None and alive(owner, changed),
    )


class StoredRun:
    """One run in a store; made by `Store.begin` and `Store.run`."""

    def __init__(self, store: Store, number: int, owner: str | None) -> None:
        self._store, self.number, self._owner = store, number, owner

    def __len__(self) -> int:
        (count,) = self._query("SELECT count(*) FROM starts WHERE run = ?").fetchone()
        return int(count)

    @property
    def path(self) -> Path:
        """The store's file."""
        return self._store.path

    def kind(self) -> str:
        """Return what kind of run it is: ``"search"`` or ``"construct"``."""
        (kind,) = self._query("SELECT kind FROM runs WHERE number = ?").fetchone()
        return str(kind)

    def settings(self) -> dict[str, Any]:
        """Return what determines the results."""
        query = "SELECT settings FROM runs WHERE number = ?"
        (text,) = self._query(query).fetchone()
        settings: dict[str, Any] = json.loads(text)
        return settings

    def decades(self) -> dict[int, int]:
        """Return how many starts ended with f in each decade, its exponent of ten the key.

        f is that after the refinement where there was one; what isn't finite is left out, and what
        is zero counts as 1e-99.
        """
        counts: dict[int, int] = {}
        query = "SELECT coalesce(refined_f, f) FROM starts WHERE run = ?"
        for (f,) in self._query(query):
            if math.isfinite(f):
                decade = math.floor(math.log10(max(f, 1e-99)))
                counts[decade] = counts.get(decade, 0) + 1
        return dict(sorted(counts.items()))

    def numbers(self, condition: str = "", *values: Any) -> Iterator[int]:
        """Yield the indices of all starts recorded, increasing, or of those of an SQL condition."""
        query = f"SELECT number FROM starts WHERE run = ? {condition} ORDER BY number"
        for (number,) in self._query(query, *values):
            yield number

    def failures(self) -> tuple[Failure, ...]:
        """Return the starts whose worker died."""
        query = "SELECT number, message FROM failures WHERE run = ? ORDER BY number"
        return tuple(Failure(*row) for row in self._query(query))

    def records(self, condition: str = "", *values: Any) -> Iterator[Record]:
        """Yield records by index, or as an SQL condition with what may follow it asks."""
        query = f"{_SELECT} {condition or 'ORDER BY number'}"
        for row in self._query(query, *values):
            yield _record(row)

    def append(self, records: Iterable[Record]) -> None:
        """Record starts, all at once or none.

        Raises
        ------
        OSError
            If the file can't be written, a full disk among other reasons.
        """
        now = time.time()
        rows = [(self.number, now, *astuple(record)) for record in records]
        with self._store._transaction():
            self._store._connection.executemany(_INSERT, rows)
            self._touch(now)

    def fail(self, failure: Failure) -> None:
        """Record that the worker of a start died."""
        now = time.time()
        with self._store._transaction():
            self._store._connection.execute(
                "INSERT OR REPLACE INTO failures (run, number, message, finished) "
                "VALUES (?, ?, ?, ?)",
                (self.number, failure.index, failure.message, now),
            )
            self._touch(now)

    def close(self) -> None:
        """Let others go on with the run; what was recorded stays."""
        if self._owner is None:
            return
        try:
            with self._store._transaction():
                self._store._connection.execute(
                    "UPDATE runs SET owner = NULL WHERE number = ? AND owner = ?",
                    (self.number, self._owner),
                )
        finally:
            AT_WORK.discard(self._owner)

    def _touch(self, now: float) -> None:
        self._store._connection.execute(
            "UPDATE runs SET changed = ? WHERE number = ?", (now, self.number)
        )

    def _query(self, query: str, *values: Any) -> sqlite3.Cursor:
        with _named_errors(self._store.path):
            return self._store._connection.execute(query, (self.number, *values))


def _record(row: tuple[Any, ...]) -> Record:
    record = Record(*row)
    wanted = {"number": int, "stages": int, "f": float, "coefficients": bytes, "seconds": float}
    for name, kind in wanted.items():
        if not isinstance(getattr(record, name), kind):
            raise ValueError(
                f"not the record of a start: {name} is {str(getattr(record, name))[:80]!r} "
                f"at start {record.number!r}"
            )
    return Record(**{**vars(record), "solved": bool(record.solved)})


def _checked(given: Any) -> Path:
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


@contextmanager
def _named_errors(path: Path) -> Iterator[None]:
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


def _canonical(settings: Mapping[str, Any]) -> str:
    return json.dumps(settings, sort_keys=True)


def _versions() -> dict[str, str]:
    try:
        package = version("crouch-grossman")
    except PackageNotFoundError:
        package = "unknown"
    return {
        "crouch-grossman": package,
        "numpy": version("numpy"),
        "python": platform.python_version(),
        "machine": f"{platform.system()} {platform.machine()}",
    }

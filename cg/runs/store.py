"""A file that keeps what long runs have found: an SQLite database that runs share.

A killed run loses nothing that it had recorded; a run with the same settings goes on from there.
Runs with other settings may use the same file, at the same time and from other processes of the
same machine.
"""

from __future__ import annotations

import errno
import json
import logging
import os
import platform
import sqlite3
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from importlib.metadata import PackageNotFoundError, version
from typing import Any

from .database import (
    StoreError,
    change_to_wal,
    checked,
    connected,
    fold_log,
    has_log,
    log_of,
    named_errors,
)
from .one_run import StoredRun
from .owner import AT_WORK, alive, owner
from .records import RunSummary
from .schema import APPLICATION_ID, MIGRATIONS

__all__ = ["Store"]

_log = logging.getLogger("cg")


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
    >>> path = tempfile.mkdtemp() + "/runs.db"
    >>> _ = cg.search(order=2, stages=2, starts=3, seed=1, store=path)
    >>> with Store(path) as store:
    ...     [(run.kind, run.starts, run.solved) for run in store.runs()]
    [('search', 3, 3)]
    """

    def __init__(self, path: str | os.PathLike[str], *, read: bool = False) -> None:
        self.path, self._reads = checked(path), read
        if read and not self.path.exists():
            raise FileNotFoundError(errno.ENOENT, "store must be a file that exists", str(path))
        with named_errors(self.path):
            self._connection = connected(self.path, "?mode=ro" if read else "")
            try:
                if read:
                    self._check_to_read()
                else:
                    self._migrate()
            except BaseException:
                self._connection.close()
                raise

    def _check_to_read(self) -> None:
        """Raise ValueError unless the file can be read as it is; an older store is brought up."""
        try:
            self._connection.execute("SELECT count(*) FROM sqlite_master").fetchone()
        except sqlite3.OperationalError as error:
            # beside a file in a folder that can't be written there can't be what readers share
            self._connection.close()
            if has_log(self.path):
                raise OSError(
                    errno.EACCES,
                    f"store can't be read: part of it is in its log {log_of(self.path).name}, and "
                    f"SQLite reads a log where it can write ({error}); copy both files elsewhere",
                    str(self.path),
                ) from error
            self._connection = connected(self.path, "?mode=ro&immutable=1")
        known, tables = self._contents()
        if known != APPLICATION_ID or not tables:
            (mode,) = self._connection.execute("PRAGMA journal_mode").fetchone()
            log = f", or one without its log {log_of(self.path).name}" if mode == "wal" else ""
            raise StoreError(f"store {self.path} is no store{log}")
        if self._schema() != len(MIGRATIONS):
            self._connection.close()
            self._connection, self._reads = connected(self.path), False
            self._migrate()
        elif not has_log(self.path) and self._owners_that_died():
            _log.warning(
                "store %s may lack starts: it has runs that were killed, or were at work when it "
                "was copied, and no log %s", self.path, log_of(self.path).name,
            )  # fmt: skip

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
        """Close the file, with all that was written in it, not in its log."""
        self._connection.close()
        if not self._reads:
            fold_log(self.path)

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
        change_to_wal(connection)
        connection.execute("PRAGMA synchronous = NORMAL")
        connection.execute("PRAGMA foreign_keys = ON")
        with self._transaction():
            for number, statements in enumerate(MIGRATIONS[self._schema() :], self._schema() + 1):
                for statement in statements:
                    connection.execute(statement)
                connection.execute(f"PRAGMA user_version = {number}")
                connection.execute(f"PRAGMA application_id = {APPLICATION_ID}")
            died = [(owner,) for owner in self._owners_that_died()]
            connection.executemany("UPDATE runs SET owner = NULL WHERE owner = ?", died)
        connection.execute("PRAGMA wal_checkpoint")

    def _owners_that_died(self) -> list[str]:
        rows = self._connection.execute("SELECT owner, changed FROM runs WHERE owner IS NOT NULL")
        return [owner for owner, changed in rows if not alive(owner, changed)]

    def _schema(self) -> int:
        (number,) = self._connection.execute("PRAGMA user_version").fetchone()
        return int(number)

    @contextmanager
    def _transaction(self) -> Iterator[None]:
        with named_errors(self.path):
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
        connection.execute("PRAGMA wal_checkpoint")  # a copy of the file says that it's at work
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
        with named_errors(self.path):
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

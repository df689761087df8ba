"""An SQLite database that stores the results of long runs.

Runs with different settings can share a file, also at the same time and from several processes of
one machine. A killed run loses nothing that it had stored; a run with the same settings continues
it.
"""

from __future__ import annotations

import errno
import json
import logging
import os
import platform
import sqlite3
import time
from collections.abc import Mapping
from importlib.metadata import PackageNotFoundError, version
from typing import Any

from cg.construction.runs.database import (
    StoreError,
    check_path,
    connect,
    fold_log,
    has_log,
    log_path,
    sqlite_errors,
    transaction,
    use_wal,
)
from cg.construction.runs.entries import RunSummary
from cg.construction.runs.one_run import StoredRun
from cg.construction.runs.owner import ACTIVE_OWNERS, is_active, new_owner
from cg.construction.runs.schema import APPLICATION_ID, TABLES, VERSION

_log = logging.getLogger("cg")


class Store:
    """An open store; also a context manager that closes it.

    With `read` an existing file is opened for reading only, and stays unchanged. ValueError if the
    file isn't a store of this version, OSError if it can't be written or read.

    >>> import tempfile, cg
    >>> path = tempfile.mkdtemp() + "/runs.db"
    >>> _ = cg.search(order=2, stages=2, starts=3, seed=1, store=path)
    >>> with Store(path) as store:
    ...     [(run.kind, run.starts, run.solved) for run in store.runs()]
    [('search', 3, 3)]
    """

    def __init__(self, path: str | os.PathLike[str], *, read: bool = False) -> None:
        self.path, self._read_only = check_path(path), read
        if read and not self.path.exists():
            raise FileNotFoundError(errno.ENOENT, "store must be an existing file", str(path))
        with sqlite_errors(self.path):
            self._connection = connect(self.path, "?mode=ro" if read else "")
            try:
                if read:
                    self._open_to_read()
                else:
                    self._open_to_write()
            except BaseException:
                self._connection.close()
                raise

    def _open_to_read(self) -> None:
        """Raise an error unless the file can be read as it is."""
        try:
            self._connection.execute("SELECT count(*) FROM sqlite_master").fetchone()
        except sqlite3.OperationalError as error:
            # in a read-only folder SQLite can't create the memory that readers share
            self._connection.close()
            if has_log(self.path):
                raise OSError(
                    errno.EACCES,
                    f"store can't be read: part of it is in its log {log_path(self.path).name}, "
                    f"and SQLite needs a writable folder to read a log ({error}); copy both files "
                    "elsewhere",
                    str(self.path),
                ) from error
            self._connection = connect(self.path, "?mode=ro&immutable=1")
        application_id, tables = self._contents()
        if application_id != APPLICATION_ID or not tables:
            (mode,) = self._connection.execute("PRAGMA journal_mode").fetchone()
            log = f", or its log {log_path(self.path).name} is missing" if mode == "wal" else ""
            raise StoreError(f"store {self.path} is not a store{log}")
        self._check_version()
        if not has_log(self.path) and self._inactive_owners():
            _log.warning(
                "store %s may lack starts: a run was killed, or was running when the file was "
                "copied, and there is no log %s", self.path, log_path(self.path).name,
            )  # fmt: skip

    def _open_to_write(self) -> None:
        """Create the tables of an empty file; release runs whose processes have ended."""
        connection = self._connection
        application_id, tables = self._contents()
        if application_id != APPLICATION_ID and (application_id or tables):
            raise StoreError(f"store {self.path} is a database of another program")
        if tables:
            self._check_version()
        use_wal(connection)
        connection.execute("PRAGMA synchronous = NORMAL")
        connection.execute("PRAGMA foreign_keys = ON")
        with transaction(connection, self.path):
            if not self._version():  # another process may have created the tables since
                for statement in TABLES:
                    connection.execute(statement)
                connection.execute(f"PRAGMA user_version = {VERSION}")
                connection.execute(f"PRAGMA application_id = {APPLICATION_ID}")
            inactive = [(owner,) for owner in self._inactive_owners()]
            connection.executemany("UPDATE runs SET owner = NULL WHERE owner = ?", inactive)
        connection.execute("PRAGMA wal_checkpoint")

    def _contents(self) -> tuple[int, int]:
        """Return the application id of the file and the number of its tables."""
        connection = self._connection
        connection.execute("BEGIN")  # one snapshot: another process may be creating the tables
        (application_id,) = connection.execute("PRAGMA application_id").fetchone()
        (tables,) = connection.execute("SELECT count(*) FROM sqlite_master").fetchone()
        connection.execute("COMMIT")
        return int(application_id), int(tables)

    def _version(self) -> int:
        (number,) = self._connection.execute("PRAGMA user_version").fetchone()
        return int(number)

    def _check_version(self) -> None:
        if self._version() != VERSION:
            raise StoreError(
                f"store {self.path} was written by another version of this package: its tables "
                f"have version {self._version()}, expected {VERSION}"
            )

    def _inactive_owners(self) -> list[str]:
        rows = self._connection.execute("SELECT owner, changed FROM runs WHERE owner IS NOT NULL")
        return [owner for owner, changed in rows if not is_active(owner, changed)]

    def __enter__(self) -> Store:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the file after moving the log of write-ahead logging into it."""
        self._connection.close()
        if not self._read_only:
            fold_log(self.path)

    def begin(self, kind: str, settings: Mapping[str, Any]) -> StoredRun:
        """Begin a run, or resume that with the same settings; OSError if another process has it."""
        # without empty ones, as versions wrote them that didn't have these
        text = json.dumps({k: v for k, v in settings.items() if v != ()}, sort_keys=True)
        connection, owner = self._connection, new_owner()
        with transaction(connection, self.path):
            row = connection.execute(
                "SELECT number, owner, changed FROM runs WHERE kind = ? AND settings = ?",
                (kind, text),
            ).fetchone()
            now = time.time()
            if row is None:
                number = connection.execute(
                    "INSERT INTO runs (kind, settings, versions, created, changed, owner) "
                    "VALUES (?, ?, ?, ?, ?, ?)",
                    (kind, text, json.dumps(_versions()), now, now, owner),
                ).lastrowid
            else:
                number, other, changed = row
                if other is not None and is_active(other, changed):
                    raise BlockingIOError(
                        errno.EAGAIN,
                        f"the run is in use by process {json.loads(other)['process']}, "
                        "which has the same settings",
                        str(self.path),
                    )
                connection.execute(
                    "UPDATE runs SET owner = ?, changed = ? WHERE number = ?", (owner, now, number)
                )
        connection.execute("PRAGMA wal_checkpoint")  # so that a copy of the file shows the owner
        assert number is not None
        ACTIVE_OWNERS.add(owner)
        return StoredRun(connection, self.path, int(number), owner)

    def run(self, number: int) -> StoredRun:
        """Return a run for reading; KeyError, which lists the numbers, if there is none."""
        numbers = [each for (each,) in self._connection.execute("SELECT number FROM runs")]
        if number not in numbers:
            raise KeyError(f"no run {number!r} in {self.path}; there are {numbers}")
        return StoredRun(self._connection, self.path, number, None)

    def runs(self) -> tuple[RunSummary, ...]:
        """Return summaries of all runs, oldest first."""
        with sqlite_errors(self.path):
            cursor = self._connection.cursor()
            cursor.row_factory = sqlite3.Row
            rows = cursor.execute(
                """
                SELECT runs.number, kind, settings, versions, created, changed, owner,
                    count(starts.number) AS starts, coalesce(sum(solved), 0) AS solved,
                    (SELECT count(*) FROM failures WHERE failures.run = runs.number) AS failed,
                    min(coalesce(refined_f, f)) AS best, coalesce(sum(seconds), 0.0) AS seconds
                FROM runs LEFT JOIN starts ON starts.run = runs.number
                GROUP BY runs.number ORDER BY runs.number
                """
            ).fetchall()
        return tuple(_summary(dict(row)) for row in rows)


def _summary(row: dict[str, Any]) -> RunSummary:
    owner = row.pop("owner")
    running = owner is not None and is_active(owner, row["changed"])
    decoded = {name: json.loads(row[name]) for name in ("settings", "versions")}
    return RunSummary(**(row | decoded), running=running)


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

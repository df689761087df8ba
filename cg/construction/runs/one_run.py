"""One run of a store: its settings, starts and failures."""

import json
import math
import sqlite3
import time
from collections.abc import Generator, Iterable, Iterator
from dataclasses import astuple, fields, replace
from pathlib import Path
from typing import Any

from cg.construction.runs.database import sqlite_errors, transaction
from cg.construction.runs.entries import Failure, StoredStart
from cg.construction.runs.owner import ACTIVE_OWNERS

_COLUMNS = tuple(field.name for field in fields(StoredStart))
_INSERT = (
    f"INSERT OR REPLACE INTO starts (run, finished, {', '.join(_COLUMNS)}) "
    f"VALUES ({', '.join('?' * (len(_COLUMNS) + 2))})"
)
_SELECT = f"SELECT {', '.join(_COLUMNS)} FROM starts WHERE run = ?"


class StoredRun:
    """One run in a store; made by `Store.begin` and `Store.run`."""

    def __init__(
        self, connection: sqlite3.Connection, path: Path, number: int, owner: str | None
    ) -> None:
        self._connection, self.path = connection, path
        self.number, self._owner = number, owner

    def __len__(self) -> int:
        (count,) = self._query("SELECT count(*) FROM starts WHERE run = ?").fetchone()
        return int(count)

    def kind(self) -> str:
        """Return the kind of the run, ``"search"`` or ``"construct"``."""
        (kind,) = self._query("SELECT kind FROM runs WHERE number = ?").fetchone()
        return str(kind)

    def settings(self) -> dict[str, Any]:
        """Return the settings, which determine the results."""
        query = "SELECT settings FROM runs WHERE number = ?"
        (text,) = self._query(query).fetchone()
        settings: dict[str, Any] = json.loads(text)
        return settings

    def decades(self) -> dict[int, int]:
        """Return the number of starts by the decade of the final f; 1e-99 is the lowest one."""
        counts: dict[int, int] = {}
        query = "SELECT coalesce(refined_f, f) FROM starts WHERE run = ?"
        for (f,) in self._query(query):
            if math.isfinite(f):
                decade = math.floor(math.log10(max(f, 1e-99)))
                counts[decade] = counts.get(decade, 0) + 1
        return dict(sorted(counts.items()))

    def numbers(self, condition: str = "", *values: Any) -> Iterator[int]:
        """Yield the numbers of all starts, increasing, or of those that meet an SQL condition."""
        query = f"SELECT number FROM starts WHERE run = ? {condition} ORDER BY number"
        for (number,) in self._query(query, *values):
            yield number

    def failures(self) -> tuple[Failure, ...]:
        """Return the starts whose worker died."""
        query = "SELECT number, message FROM failures WHERE run = ? ORDER BY number"
        return tuple(Failure(*row) for row in self._query(query))

    def entries(self, condition: str = "", *values: Any) -> Generator[StoredStart, None, None]:
        """Yield the entries by number, or those that an SQL condition selects, in its order."""
        query = f"{_SELECT} {condition or 'ORDER BY number'}"
        for row in self._query(query, *values):
            yield _entry(row)

    def append(self, entries: Iterable[StoredStart]) -> None:
        """Store entries of starts in one transaction."""
        now = time.time()
        rows = [(self.number, now, *astuple(entry)) for entry in entries]
        with transaction(self._connection, self.path):
            self._connection.executemany(_INSERT, rows)
            self._touch(now)

    def fail(self, failure: Failure) -> None:
        """Store a failure."""
        now = time.time()
        with transaction(self._connection, self.path):
            self._connection.execute(
                "INSERT OR REPLACE INTO failures (run, number, message, finished) "
                "VALUES (?, ?, ?, ?)",
                (self.number, failure.index, failure.message, now),
            )
            self._touch(now)

    def close(self) -> None:
        """Release the run, so that other processes can resume it."""
        if self._owner is None:
            return
        try:
            with transaction(self._connection, self.path):
                self._connection.execute(
                    "UPDATE runs SET owner = NULL WHERE number = ? AND owner = ?",
                    (self.number, self._owner),
                )
        finally:
            ACTIVE_OWNERS.discard(self._owner)

    def _touch(self, now: float) -> None:
        self._connection.execute("UPDATE runs SET changed = ? WHERE number = ?", (now, self.number))

    def _query(self, query: str, *values: Any) -> sqlite3.Cursor:
        with sqlite_errors(self.path):
            return self._connection.execute(query, (self.number, *values))


def _entry(row: tuple[Any, ...]) -> StoredStart:
    entry = StoredStart(**dict(zip(_COLUMNS, row, strict=True)))
    kinds = {"number": int, "stages": int, "f": float, "coefficients": bytes, "seconds": float}
    for name, kind in kinds.items():
        if not isinstance(getattr(entry, name), kind):
            raise ValueError(
                f"not the entry of a start: {name} is {str(getattr(entry, name))[:80]!r} "
                f"at start {entry.number!r}"
            )
    return replace(entry, solved=bool(entry.solved))

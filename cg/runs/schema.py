"""The tables of a store, version by version.

What a version was is never edited: the next one changes its tables.
"""

from __future__ import annotations

__all__ = ["APPLICATION_ID", "MIGRATIONS"]

APPLICATION_ID = 0x63675247
"""By which SQLite's files tell what program they belong to."""

_FIRST = (
    """
    CREATE TABLE runs (
        number INTEGER PRIMARY KEY,
        kind TEXT NOT NULL,
        settings TEXT NOT NULL,
        versions TEXT NOT NULL,
        created REAL NOT NULL,
        changed REAL NOT NULL,
        owner TEXT,
        UNIQUE (kind, settings)
    )
    """,
    """
    CREATE TABLE starts (
        run INTEGER NOT NULL REFERENCES runs (number) ON DELETE CASCADE,
        number INTEGER NOT NULL,
        stages INTEGER NOT NULL,
        flows INTEGER,
        tree TEXT,
        phase TEXT NOT NULL,
        f REAL NOT NULL,
        status INTEGER,
        evaluations INTEGER,
        refined_f REAL,
        refined_status INTEGER,
        refined_evaluations INTEGER,
        largest_residual REAL,
        solved INTEGER NOT NULL,
        coefficients BLOB NOT NULL,
        seconds REAL NOT NULL,
        finished REAL NOT NULL,
        PRIMARY KEY (run, number)
    )
    """,
)

_SECOND = (
    """
    CREATE TABLE failures (
        run INTEGER NOT NULL REFERENCES runs (number) ON DELETE CASCADE,
        number INTEGER NOT NULL,
        message TEXT NOT NULL,
        finished REAL NOT NULL,
        PRIMARY KEY (run, number)
    )
    """,
    "CREATE INDEX solved_starts ON starts (run, number) WHERE solved",
)

MIGRATIONS: tuple[tuple[str, ...], ...] = (_FIRST, _SECOND)
"""Statements that lead from each version to the next; version 0 is an empty file."""

"""Looking at what another process does."""

import sqlite3
from contextlib import closing
from pathlib import Path


def has_started(file: Path) -> bool:
    """Return whether a start has ended in a store that another process makes."""
    try:
        with closing(sqlite3.connect(f"{file.as_uri()}?mode=ro", uri=True)) as store:
            (count,) = store.execute("SELECT count(*) FROM starts").fetchone()
    except sqlite3.OperationalError:  # not there yet, or empty
        return False
    return count > 0

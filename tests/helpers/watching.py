"""Searches in a process of their own, which are interrupted when they are at work."""

import signal
import sqlite3
import subprocess
import time
from collections.abc import Sequence
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


def interrupted_search(command: Sequence[str], file: Path) -> tuple[int, str]:
    """Interrupt a command once a start is in its store; return its exit code and what it said."""
    running = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
    try:
        while not has_started(file) and running.poll() is None:
            time.sleep(0.05)
        running.send_signal(signal.SIGINT)
        _, error = running.communicate(timeout=120)
    finally:
        running.kill()
    return running.returncode, error

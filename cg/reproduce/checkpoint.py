"""A file of finished parts of a long item, one per line, from which a killed run continues."""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

__all__ = ["Checkpoint", "DamagedError"]


class DamagedError(ValueError):
    """A checkpoint has a line that cannot be read."""


class Checkpoint:
    """A file of records, one JSON value per line, that grows by `append`.

    An incomplete last line, which a killed run leaves, is removed.

    Parameters
    ----------
    path : Path
        The file; it is created if it does not exist.
    read : callable, optional
        Makes a record from a JSON value, or raises ValueError.

    Attributes
    ----------
    records : tuple
        The records in the file when it was opened.

    Raises
    ------
    DamagedError
        If a complete line is not JSON or not a record.
    OSError
        If the file cannot be written.
    """

    def __init__(self, path: Path, read: Callable[[Any], Any] = lambda record: record) -> None:
        self._stream = path.open("ab+")
        self._stream.seek(0)
        text = self._stream.read()
        whole = text[: text.rfind(b"\n") + 1]
        try:
            self.records = tuple(read(json.loads(line)) for line in whole.splitlines())
        except ValueError as error:
            self._stream.close()
            raise DamagedError(f"{path} has a damaged line: {error}") from error
        if len(whole) < len(text):
            self._stream.truncate(len(whole))

    def append(self, record: Any) -> None:
        """Write a record to disk."""
        self._stream.write(json.dumps(record).encode() + b"\n")
        self._stream.flush()
        os.fsync(self._stream.fileno())

    def close(self) -> None:
        """Close the file."""
        self._stream.close()

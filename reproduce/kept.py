"""A file that keeps pieces of a long item, one a line, so that a killed run goes on from them."""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

__all__ = ["DamagedError", "Kept"]


class DamagedError(ValueError):
    """A file of which a line can't be read."""


class Kept:
    """Records of a file, and those that are appended to it.

    A line that a killed run left unfinished is dropped.

    Parameters
    ----------
    path : Path
        The file, which is made if there is none.
    read : callable, optional
        Turns what JSON gives into a record, or raises ValueError.

    Attributes
    ----------
    records : tuple
        What the file held when it was opened.

    Raises
    ------
    DamagedError
        If another line than the last isn't JSON, or no record.
    OSError
        If the file can't be written.
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
        """Write a record, and make sure that it is on disk."""
        self._stream.write(json.dumps(record).encode() + b"\n")
        self._stream.flush()
        os.fsync(self._stream.fileno())

    def close(self) -> None:
        """Close the file."""
        self._stream.close()

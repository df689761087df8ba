"""A file that keeps pieces of a long item, one a line, so that a killed run goes on from them."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

__all__ = ["Kept"]


class Kept:
    """Records of a file, and those that are appended to it.

    A line that a killed run left unfinished is dropped.

    Parameters
    ----------
    path : Path
        The file, which is made if there is none.

    Attributes
    ----------
    records : tuple
        What the file held when it was opened.

    Raises
    ------
    ValueError
        If another line than the last isn't JSON.
    OSError
        If the file can't be written.
    """

    def __init__(self, path: Path) -> None:
        self._stream = path.open("a+", encoding="utf-8")
        self._stream.seek(0)
        text = self._stream.read()
        whole = text[: text.rfind("\n") + 1]
        try:
            self.records = tuple(json.loads(line) for line in whole.splitlines())
        except ValueError as error:
            self._stream.close()
            raise ValueError(f"{path} has a damaged line: {error}") from error
        if len(whole) < len(text):
            self._stream.truncate(len(whole.encode("utf-8")))

    def append(self, record: Any) -> None:
        """Write a record, and make sure that it is on disk."""
        self._stream.write(json.dumps(record) + "\n")
        self._stream.flush()
        os.fsync(self._stream.fileno())

    def close(self) -> None:
        """Close the file."""
        self._stream.close()

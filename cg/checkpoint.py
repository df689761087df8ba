"""A file that keeps what a long run has found, one record a line.

A killed run loses at most the line that it was writing; a run with the same settings
goes on from there.
"""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any, TextIO

__all__ = ["Checkpoint"]

_FORMAT = "cg checkpoint 1"


class Checkpoint:
    """An open checkpoint file; made by `open`.

    Attributes
    ----------
    records : tuple of dict
        What the file held when it was opened.
    """

    def __init__(self, stream: TextIO, records: tuple[dict[str, Any], ...]) -> None:
        self._stream = stream
        self.records = records

    @classmethod
    def open(cls, path: str | os.PathLike[str], settings: Mapping[str, Any]) -> Checkpoint:
        """Open for appending, and read what is there.

        Parameters
        ----------
        path : path
        settings : mapping
            What the run does; a file that begins with other settings is refused.

        Raises
        ------
        TypeError
            If it isn't a path.
        ValueError
            If it isn't a file, belongs to other settings, or has a damaged line before its last.
        OSError
            If it can't be written, or is in use by another run.
        """
        if not isinstance(path, str | os.PathLike):
            raise TypeError(f"checkpoint must be a path, got {path!r}")
        path = Path(path)
        # a device or a pipe may never end
        if path.exists() and not (path.is_file() or path.is_dir()):
            raise ValueError(f"checkpoint must be a file, got {path}, which exists and is none")
        header = json.dumps({"format": _FORMAT, **settings})
        stream = path.open("a+", encoding="utf-8")
        try:
            _lock(stream, path)
            stream.seek(0)
            try:
                text = stream.read()
            except UnicodeDecodeError as error:
                raise ValueError(f"checkpoint {path} isn't text: {error}") from error
            whole = text[: text.rfind("\n") + 1]
            lines = whole.splitlines()
            if lines[:1] != [header] and (lines or not header.startswith(text)):
                raise ValueError(
                    f"checkpoint {path} belongs to another run: expected {header}, "
                    f"it begins with {text[:200]!r}"
                )
            if len(whole) < len(text):  # the line that a killed run left unfinished
                stream.truncate(len(whole.encode("utf-8")))
            opened = cls(stream, tuple(_read(line, path) for line in lines[1:]))
            if not lines:
                opened._write(header)
        except BaseException:
            stream.close()
            raise
        return opened

    def append(self, record: Mapping[str, Any]) -> None:
        """Write one record, and make sure that it is on disk."""
        self._write(json.dumps(dict(record)))

    def close(self) -> None:
        """Close the file."""
        self._stream.close()

    def _write(self, line: str) -> None:
        self._stream.write(line + "\n")
        self._stream.flush()
        os.fsync(self._stream.fileno())


def _lock(stream: TextIO, path: Path) -> None:
    """Refuse a file that another run, of this process or another, has open."""
    try:
        import fcntl
    except ImportError:  # no such locks on this system
        return
    try:
        fcntl.flock(stream.fileno(), fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError as error:
        raise BlockingIOError(
            error.errno, "checkpoint is in use by another run", str(path)
        ) from None


def _read(line: str, path: Path) -> dict[str, Any]:
    try:
        record = json.loads(line)
    except ValueError as error:
        raise ValueError(f"checkpoint {path} has a damaged line: {line[:80]!r}") from error
    if not isinstance(record, dict):
        raise ValueError(f"checkpoint {path} has a damaged line: {line[:80]!r}")
    return record

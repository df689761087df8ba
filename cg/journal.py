"""The file that keeps what a search has found, a line a start.

A killed run loses at most the line that it was writing; a search with the same
settings goes on from there.
"""

from __future__ import annotations

import json
import os
from dataclasses import asdict
from pathlib import Path
from typing import TextIO

from .starts import Phase, SearchSettings, Start

__all__ = ["Journal"]

_FORMAT = "cg search 1"


class Journal:
    """An open journal; made by `open`."""

    def __init__(self, stream: TextIO, starts: tuple[Start, ...]) -> None:
        self._stream = stream
        self.starts = starts

    @classmethod
    def open(cls, path: str | os.PathLike[str], settings: SearchSettings) -> Journal:
        """Open for appending; read the starts that it already holds.

        Raises
        ------
        ValueError
            If the file belongs to other settings, or isn't a journal.
        OSError
            If it can't be written.
        """
        path = Path(path)
        header = json.dumps({"format": _FORMAT, **asdict(settings)})
        stream = path.open("a+", encoding="utf-8")
        try:
            stream.seek(0)
            text = stream.read()
            whole = text[: text.rfind("\n") + 1]
            lines = whole.splitlines()
            if text and (not lines or lines[0] != header):
                raise ValueError(
                    f"checkpoint {path} belongs to another search: expected {header}, "
                    f"it begins with {text[:200]!r}"
                )
            if len(whole) < len(text):  # the line that a killed run left unfinished
                stream.truncate(len(whole.encode("utf-8")))
            starts = tuple(_read(line, path) for line in lines[1:])
            journal = cls(stream, starts)
            if not text:
                journal._write(header)
        except BaseException:
            stream.close()
            raise
        return journal

    def append(self, start: Start) -> None:
        """Write one start, and make sure that it is on disk."""
        self._write(json.dumps(asdict(start)))

    def close(self) -> None:
        """Close the file."""
        self._stream.close()

    def _write(self, line: str) -> None:
        self._stream.write(line + "\n")
        self._stream.flush()
        os.fsync(self._stream.fileno())


def _read(line: str, path: Path) -> Start:
    try:
        fields = json.loads(line)
        refined = fields["quad"]
        return Start(
            index=fields["index"],
            double=Phase(**fields["double"]),
            quad=None if refined is None else Phase(**refined),
            x=tuple(fields["x"]),
            largest_residual=fields["largest_residual"],
            exact=fields["exact"],
        )
    except (KeyError, TypeError, ValueError) as error:
        raise ValueError(f"checkpoint {path} has a damaged line: {line[:80]!r}") from error

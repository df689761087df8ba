"""What the writers of all languages share: headings, and long lists in short lines."""

from __future__ import annotations

import textwrap
from collections.abc import Iterable, Sequence

from ..support.parsing import visible

__all__ = ["comment", "heading", "integers", "real", "wrapped"]

_WIDTH = 96


def heading(title: str, source: str) -> str:
    """Return what a file says of the method it holds."""
    return f"{title}\n{source}" if source else title


def comment(text: str, mark: str) -> str:
    """Return a text as lines of comment, none of which the next line continues."""
    lines = []
    for paragraph in text.splitlines():
        lines += textwrap.wrap(visible(paragraph), _WIDTH) or [""]
    # in C a comment goes on after a backslash, which ??/ is too
    ends = (" ." if line.endswith(("\\", "??/")) else "" for line in lines)
    return "\n".join(f"{mark} {line}{end}".rstrip() for line, end in zip(lines, ends, strict=True))


def real(number: str) -> str:
    """Return a decimal number so that no language takes it for an integer."""
    return number if "." in number or "e" in number else f"{number}.0"


def wrapped(entries: Iterable[str], indent: str, separator: str = ", ", end: str = "") -> str:
    """Return entries of a list in lines that aren't too long; `end` stands before line breaks."""
    lines: list[str] = []
    line: list[str] = []
    length = 0
    for entry in entries:
        if line and length + len(entry) > _WIDTH:
            lines.append(separator.join(line))
            line, length = [], 0
        line.append(entry)
        length += len(entry) + len(separator)
    lines.append(separator.join(line))
    between = separator.rstrip() + end + "\n"
    return between.join(indent + text for text in lines)


def integers(values: Sequence[int], shift: int = 0) -> list[str]:
    """Return integers as texts, counted from `shift`."""
    return [str(value + shift) for value in values]

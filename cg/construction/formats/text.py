"""Text functions of both languages: comments, lists over several lines, templates."""

import textwrap
from collections.abc import Iterable, Mapping, Sequence
from functools import cache
from importlib.resources import files

from cg.support.parsing import visible

_WIDTH = 96


@cache
def template(*names: str) -> str:
    """Return the texts of files in the folder ``templates``, one after the other, for `fill`."""
    folder = files("cg.construction.formats") / "templates"
    return "".join((folder / f"{name}.in").read_text(encoding="utf-8") for name in names)


def fill(template: str, parts: Mapping[str, object]) -> str:
    """Return a template with each ``@key@``, also in earlier parts, replaced by its part."""
    for key, part in parts.items():
        template = template.replace(f"@{key}@", str(part))
    return template


def comment(text: str, mark: str) -> str:
    """Return a text as comment lines, none of which ends in a line continuation."""
    lines = []
    for paragraph in text.splitlines():
        lines += textwrap.wrap(visible(paragraph), _WIDTH) or [""]
    # in C a backslash, also written ??/, continues a comment on the next line
    ends = (" ." if line.endswith(("\\", "??/")) else "" for line in lines)
    return "\n".join(f"{mark} {line}{end}".rstrip() for line, end in zip(lines, ends, strict=True))


def real(number: str) -> str:
    """Return a decimal number as a real literal, with a point or an exponent."""
    return number if "." in number or "e" in number else f"{number}.0"


def wrapped(entries: Iterable[str], indent: str) -> str:
    """Return the entries of a list over lines of limited length."""
    lines: list[str] = []
    line: list[str] = []
    length = 0
    for entry in entries:
        if line and length + len(entry) > _WIDTH:
            lines.append(", ".join(line))
            line, length = [], 0
        line.append(entry)
        length += len(entry) + 2
    lines.append(", ".join(line))
    return ",\n".join(indent + text for text in lines)


def array(declared: str, entries: Sequence[str]) -> str:
    """Return the definition of an array in C."""
    entries = entries or ["0"]  # C has no empty arrays
    return f"{declared}[{len(entries)}] = {{\n{wrapped(entries, '    ')}\n}};"


def reals(name: str, table: str, texts: Iterable[str]) -> str:
    """Return the definition of an array of real numbers, of the type that the header names."""
    values = [f"{name.upper()}_NUMBER({real(text)})" for text in texts]
    return array(f"static const {name.upper()}_REAL {name}_{table}", values)

"""Reading and writing of numbers, TOML, JSON and files, with bounds and clear errors."""

import json
import os
import re
import secrets
import shutil
import tomllib
from collections.abc import Callable, Iterable
from contextlib import suppress
from decimal import Decimal
from fractions import Fraction
from functools import partial
from importlib.resources.abc import Traversable
from os import PathLike
from pathlib import Path
from typing import Any
from unicodedata import category

MAX_CHARACTERS = 10_000_000
"""Largest length of a file; 200 stages with coefficients of 200 digits need four million."""

MAX_POWER_OF_TEN = 9999
"""Largest absolute exponent of a number; binary128 ends at 4932."""

_EXPONENT = re.compile(r"[eE]([+-]?[\d_]+)\s*$")
_MAX_DEPTH = 20
_MAX_NAME = 200  # bytes; file systems take 255, with suffixes
_UNFIT = re.compile(r'[/\\:*?"<>|\x00-\x1f\x7f]')
_DEVICE = re.compile(r"(con|prn|aux|nul|com\d|lpt\d)(\..*)?", re.IGNORECASE)


def _escaped(text: str, escape: Callable[[str], str]) -> str:
    """Return a text with each character that isn't printable replaced by ``escape(character)``."""
    if text.isprintable():
        return text
    return "".join(letter if letter.isprintable() else escape(letter) for letter in text)


def visible(text: str) -> str:
    """Return a text with all characters escaped that aren't printable, also line breaks."""

    def escape(letter: str) -> str:
        if category(letter) == "Zs":  # spaces of other widths
            return letter
        return letter.encode("unicode_escape").decode("ascii")

    return _escaped(text, escape)


def visible_lines(text: str) -> str:
    """Return a text with all characters escaped that aren't printable, except line breaks."""
    return "\n".join(map(visible, text.split("\n")))


def quoted(text: str) -> str:
    """Return a text as a TOML string of printable characters."""
    return _escaped(json.dumps(text, ensure_ascii=False), lambda x: f"\\U{ord(x):08x}")


def to_json(data: Any, **options: Any) -> str:
    """Return data as JSON of printable characters and line breaks; options as for `json.dumps`."""
    text = json.dumps(data, ensure_ascii=False, allow_nan=False, **options)
    return _escaped(text, lambda x: x if x == "\n" else json.dumps(x)[1:-1])


def read_fraction(value: Any) -> Fraction:
    """Return what `fractions.Fraction` makes of a value; ValueError for powers beyond reason."""
    exponent = 0
    if isinstance(value, str):
        match = _EXPONENT.search(value)
        if match:
            digits = match[1].lstrip("+-").replace("_", "").lstrip("0")
            exponent = int(digits or 0) if len(digits) < 10 else 10**10
    elif isinstance(value, Decimal) and value.is_finite():
        exponent = abs(int(value.as_tuple().exponent))
    if exponent > MAX_POWER_OF_TEN:
        raise ValueError(f"exponents must be at most {MAX_POWER_OF_TEN}, got {str(value)[:80]!r}")
    return Fraction(value)


def read_file(path: Traversable, error: type[Exception]) -> str:
    """Return the text of a regular file, since a pipe may never end, in UTF-8; or raise `error`."""
    if isinstance(path, Path) and path.exists() and not (path.is_file() or path.is_dir()):
        raise error("not a regular file")
    with path.open("rb") as file:
        content = file.read(MAX_CHARACTERS + 1)
    if len(content) > MAX_CHARACTERS:
        raise error(f"a file must have at most {MAX_CHARACTERS} bytes")
    try:
        return content.decode("utf-8-sig")  # some editors write a byte-order mark
    except UnicodeDecodeError as problem:
        raise error(f"not UTF-8: {problem}") from None


def read_toml(text: str, error: type[Exception], **options: Any) -> dict[str, Any]:
    """Return the table of a TOML text; options as for `tomllib.loads`."""
    return _read("TOML", partial(tomllib.loads, **options), text, error)


def read_json(text: str, error: type[Exception]) -> dict[str, Any]:
    """Return the object of a JSON text, with numbers that aren't integers as strings."""

    def unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
        table = dict(pairs)
        if len(table) < len(pairs):
            keys = [key for key, _ in pairs]
            raise ValueError(f"{max(keys, key=keys.count)!r} is there twice")
        return table

    def refuse(number: str) -> None:
        raise ValueError(f"{number} isn't a finite number")

    options: dict[str, Any] = {"parse_constant": refuse, "object_pairs_hook": unique}
    return _read("JSON", partial(json.loads, parse_float=str, **options), text, error)


def _read(
    language: str, parse: Callable[[str], Any], text: str, error: type[Exception]
) -> dict[str, Any]:
    if len(text) > MAX_CHARACTERS:
        raise error(f"a file must have at most {MAX_CHARACTERS} characters, got {len(text)}")
    try:
        table = parse(text)
        if not isinstance(table, dict):
            raise ValueError(f"a JSON object was expected, got {text[:40]!r}")
        _check_depth(table)
    except (tomllib.TOMLDecodeError, json.JSONDecodeError) as problem:
        raise error(f"not a {language} file: {problem}") from None
    except RecursionError:
        raise error("not a file of this kind: tables or arrays are nested too deeply") from None
    except ValueError as problem:  # also a number with too many digits
        raise error(f"not a file of this kind: {problem}") from None
    return table


def check_keys(
    table: dict[str, Any],
    required: Iterable[str],
    optional: Iterable[str],
    where: str,
    error: type[Exception],
) -> None:
    """Raise `error` with all missing and unknown keys of a table."""
    missing, unknown = set(required) - set(table), set(table) - {*required, *optional}
    problems = [f"{where} lacks {', '.join(sorted(missing))}"] * bool(missing)
    problems += [f"{where} has unknown keys: {', '.join(sorted(unknown))}"] * bool(unknown)
    if problems:
        raise error("; ".join(problems))


def _check_depth(table: dict[str, Any]) -> None:
    """Raise RecursionError if a table is nested too deeply to be printed."""
    level: list[Any] = [table]
    for _ in range(_MAX_DEPTH):
        level = [
            value
            for whole in level
            if isinstance(whole, dict | list)
            for value in (whole.values() if isinstance(whole, dict) else whole)
        ]
    if level:
        raise RecursionError


def file_in(folder: str | PathLike[str], name: str, suffix: str = ".toml") -> Path:
    """Return the path of a file in a folder; ValueError if a system doesn't allow its name."""
    fit = (
        0 < len(name.encode("utf-8", "replace")) <= _MAX_NAME
        and not _UNFIT.search(name)
        and not name.startswith(".")
        and name.strip(" ") == name
        and not name.endswith(".")
        and not _DEVICE.fullmatch(name)
    )
    if not fit:
        raise ValueError(f"name must be fit for a file's name, got {name[:80]!r}")
    return Path(folder) / f"{name}{suffix}"


def write_file(path: str | PathLike[str], data: str | bytes) -> None:
    """Write a file atomically, texts in UTF-8: after an error the old file is unchanged.

    The data go to a temporary file beside it, which then replaces it. Symbolic links and
    permissions are kept. A device is written directly. Errors name the file.
    """
    path, content = Path(path), data.encode("utf-8") if isinstance(data, str) else data
    if path.exists() and not path.is_file():
        path.write_bytes(content)
        return
    target = path.resolve()
    temporary = target.with_name(f".{secrets.token_hex(8)}.part")
    try:
        with temporary.open("xb") as file:
            if target.exists():
                target.open("ab").close()  # raises if the file is read-only
                shutil.copymode(target, temporary)
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        os.replace(temporary, target)
    except OSError as error:
        raise type(error)(error.errno, error.strerror, str(path)) from None
    finally:
        with suppress(OSError):
            temporary.unlink()

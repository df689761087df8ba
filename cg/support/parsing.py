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

MAX_CHARACTERS = 10_000_000
"""Largest length of a file; 200 stages with coefficients of 200 digits need four million."""

MAX_POWER_OF_TEN = 9999
"""Largest absolute exponent of a number; binary128 ends at 4932."""

_EXPONENT = re.compile(r"[eE]([+-]?[\d_]+)\s*$")


def visible(text: str) -> str:
    """Return a text with all characters escaped that aren't printable, also line breaks."""
    return "".join(
        letter if letter.isprintable() else letter.encode("unicode_escape").decode("ascii")
        for letter in text
    )


def quoted(text: str) -> str:
    """Return a text as a TOML string of printable characters."""
    escaped = json.dumps(text, ensure_ascii=False)
    return "".join(x if x.isprintable() else f"\\U{ord(x):08x}" for x in escaped)


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
        keys = [key for key, _ in pairs]
        if len(set(keys)) < len(keys):
            raise ValueError(f"{max(keys, key=keys.count)!r} is there twice")
        return dict(pairs)

    parse = partial(json.loads, parse_float=str, parse_constant=str, object_pairs_hook=unique)
    table = _read("JSON", parse, text, error)
    if not isinstance(table, dict):
        raise error(f"not a JSON file of this kind: an object was expected, got {text[:40]!r}")
    return table


def _read(
    language: str, parse: Callable[[str], dict[str, Any]], text: str, error: type[Exception]
) -> dict[str, Any]:
    try:
        return parse(text)
    except (ValueError, RecursionError) as problem:  # also a number with too many digits
        raise error(f"not a {language} file: {problem}") from None


def check_keys(
    table: dict[str, Any], required: Iterable[str], optional: Iterable[str], where: str,
    error: type[Exception],
) -> None:  # fmt: skip
    """Raise `error` with all missing and unknown keys of a table."""
    missing, unknown = set(required) - set(table), set(table) - {*required, *optional}
    problems = [f"{where} lacks {', '.join(sorted(missing))}"] * bool(missing)
    problems += [f"{where} has unknown keys: {', '.join(sorted(unknown))}"] * bool(unknown)
    if problems:
        raise error("; ".join(problems))


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

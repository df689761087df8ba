"""Methods of the user: files in folders of their own, by the names inside them."""

from __future__ import annotations

import os
import sys
import warnings
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path

from ..method.method import Method
from ..structure.points import MethodError
from ..support.parsing import visible
from .entries import SUFFIXES, read

__all__ = ["PROOF", "VARIABLE", "OwnMethods", "own_folders", "proof_beside"]

PROOF = ".certificate.toml"
"""What the names of certificates end in, which are beside the files of methods."""

VARIABLE = "CG_METHODS"
"""The environment variable with the folders of the user, in place of the usual one."""

_APPLICATION = "crouch-grossman"

_Stamp = tuple[str, int, int]  # path, time of modification, size


def own_folders() -> tuple[Path, ...]:
    """Return the folders in which methods of the user are looked for; they need not exist.

    Those that the environment variable ``CG_METHODS`` lists, separated as in ``PATH``; none if it
    is empty. Without it the folder ``crouch-grossman/methods`` where programs keep their settings:
    ``$XDG_CONFIG_HOME`` or ``~/.config``, on macOS ``~/Library/Application Support``, on Windows
    ``%APPDATA%``.
    """
    listed = os.environ.get(VARIABLE)
    if listed is not None:
        return tuple(Path(part).expanduser() for part in listed.split(os.pathsep) if part.strip())
    try:
        settings = _settings_folder()
    except RuntimeError:  # nobody's home
        return ()
    return (settings / _APPLICATION / "methods",)


def proof_beside(file: Path) -> Path:
    """Return where the certificate of the method in a file is, if there is one.

    It is beside the file, or in a folder ``certificates`` beside it.
    """
    kept = file.parent / "certificates" / f"{file.stem}.toml"
    return kept if kept.is_file() else file.with_name(file.stem + PROOF)


def _settings_folder() -> Path:
    if sys.platform == "win32":
        given = os.environ.get("APPDATA")
        return Path(given) if given else Path.home() / "AppData" / "Roaming"
    if sys.platform == "darwin":
        return Path.home() / "Library" / "Application Support"
    given = os.environ.get("XDG_CONFIG_HOME")
    return Path(given) if given and Path(given).is_absolute() else Path.home() / ".config"


class OwnMethods(Mapping[str, Method]):
    """The methods in the folders of the user, as they are when they are asked for.

    Files that are no methods, and names that are taken, are left out, and a warning says so once.

    Parameters
    ----------
    taken : callable
        Tells whether a name belongs to the package.
    """

    def __init__(self, taken: Callable[[str], bool]) -> None:
        self._taken = taken
        self._stamps: tuple[_Stamp, ...] = ()
        self._methods: dict[str, Method] = {}
        self._files: dict[str, Path] = {}
        self._problems: dict[str, str] = {}

    def problem(self, name: str) -> str | None:
        """Return why a file of that name, without suffix, holds no method that can be used."""
        self._refresh()
        return self._problems.get(name)

    def proof(self, name: str) -> Path:
        """Return where the certificate of a method is, if there is one."""
        self._refresh()
        return proof_beside(self._files[name])

    def __getitem__(self, name: str) -> Method:
        self._refresh()
        return self._methods[name]

    def __iter__(self) -> Iterator[str]:
        self._refresh()
        return iter(self._methods)

    def __len__(self) -> int:
        self._refresh()
        return len(self._methods)

    def _refresh(self) -> None:
        """Read the files again if one of them has changed."""
        files = [path for folder in own_folders() for path in _files_in(folder)]
        stamps = tuple(map(_stamp, files))
        if stamps == self._stamps:
            return
        known = set(self._problems.values())
        methods: dict[str, Method] = {}
        where: dict[str, Path] = {}
        problems: dict[str, str] = {}
        for text, _, _ in stamps:
            path = Path(text)
            try:
                method = read(path)
                self._check_name(method.name, path, methods)
            except (MethodError, OSError) as error:
                problems[path.stem] = str(error)
            else:
                methods[method.name], where[method.name] = method, path
        self._stamps, self._methods, self._problems = stamps, methods, problems
        self._files = where
        for problem in problems.values():
            if problem not in known:
                warnings.warn(f"left out of cg.methods: {visible(problem)}", stacklevel=4)

    def _check_name(self, name: str, path: Path, methods: Mapping[str, Method]) -> None:
        if not name.strip():
            raise MethodError(f"{path}: the method has no name")
        if self._taken(name):
            raise MethodError(f"{path}: the package has a method named {name!r}; choose another")
        if name in methods:
            raise MethodError(f"{path}: another file has a method named {name!r}")


def _files_in(folder: Path) -> list[Path]:
    try:
        return sorted(
            path
            for path in folder.iterdir()
            if path.suffix.lower() in SUFFIXES
            and not path.name.endswith(PROOF)
            and (path.is_file() or path.is_dir() or not path.exists())  # a pipe may never end
        )
    except OSError:  # there is no such folder, or it may not be read
        return []


def _stamp(path: Path) -> _Stamp:
    try:
        status = path.stat()
    except OSError:
        return str(path), 0, 0  # reading it will tell why
    return str(path), status.st_mtime_ns, status.st_size

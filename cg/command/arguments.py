"""Arguments and options that commands share, and functions for their output."""

import json
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import click
from click.shell_completion import CompletionItem

from cg.command.main import message_of
from cg.construction.catalogue import is_file, load, methods, similar_names
from cg.construction.methods.method import Method
from cg.construction.points import MethodError
from cg.support.parsing import visible

F = TypeVar("F", bound=Callable[..., Any])

json_option = click.option("--json", "in_json", is_flag=True, help="Print JSON.")


def count_option(name: str, help: str) -> Callable[[F], F]:
    """Return an option that is a positive number N."""
    return click.option(name, type=click.IntRange(1), metavar="N", help=help)


def output_option(help: str) -> Callable[[F], F]:
    """Return the option for the file that a command writes."""
    file = click.Path(dir_okay=False, path_type=Path)
    return click.option("--output", "-o", type=file, metavar="FILE", help=help)


class MethodArgument(click.ParamType):  # type: ignore[type-arg]
    """Type of an argument that names a method or a file: `make` converts it, or `read`."""

    name = "NAME|FILE"

    def __init__(self, make: Callable[[Method], Any], read: Callable[[str], Any]) -> None:
        self._make, self._read = make, read

    def shell_complete(
        self, ctx: click.Context, param: click.Parameter, incomplete: str
    ) -> list[CompletionItem]:
        """Return the names in the catalogue that begin so, or files if none does."""
        names = [n for n in methods if n.isprintable() and n.lower().startswith(incomplete.lower())]
        return [*map(CompletionItem, names)] or [CompletionItem(incomplete, type="file")]

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Return what is made of the method; raise BadParameter if it can't be read."""
        try:
            if is_file(value):
                return self._read(value)
            if value in methods:
                return self._make(methods[value])
        except (MethodError, OSError, TypeError, ValueError) as error:
            self.fail(message_of(error), param)
        similar = similar_names(value)
        self.fail(
            f"no method is named {value!r}, and no .toml or .json file is there{similar}", param
        )


METHOD = MethodArgument(lambda method: method, load)


def as_json(data: Any) -> None:
    """Print data as JSON."""
    click.echo(json.dumps(data, indent=2))


def say(text: str, *, err: bool = False) -> None:
    """Print lines of text with all other control characters escaped."""
    click.echo("\n".join(map(visible, text.split("\n"))), err=err)


def check_output(path: Path | None) -> None:
    """Raise BadParameter unless a file can be written; commands call it before they compute."""
    if path is None:
        return
    folder = path.absolute().parent
    if not folder.is_dir():
        raise click.BadParameter(f"{path} must be in an existing folder", param_hint="--output")
    if not os.access(path if path.exists() else folder, os.W_OK):
        raise click.BadParameter(f"{path} can't be written", param_hint="--output")

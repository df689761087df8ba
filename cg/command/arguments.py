"""Options that commands share, the exit code of a negative result, and functions for output."""

import json
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import click

from cg.support.parsing import visible

F = TypeVar("F", bound=Callable[..., Any])

NEGATIVE = 1  # exit code of a negative result

json_option = click.option("--json", "in_json", is_flag=True, help="Print JSON.")
output_option = click.option(
    "--output", "-o", type=click.Path(dir_okay=False, path_type=Path), help="Output file."
)


def count_option(name: str, help: str) -> Callable[[F], F]:
    """Return an option that is a positive number N."""
    return click.option(name, type=click.IntRange(1), metavar="N", help=help)


def print_json(data: Any) -> None:
    """Print data as JSON."""
    click.echo(json.dumps(data, indent=2))


def print_text(text: str) -> None:
    """Print lines of text with all other control characters escaped."""
    click.echo("\n".join(map(visible, text.split("\n"))))


def check_output(path: Path | None, *inputs: str | Path | None) -> None:
    """Raise BadParameter unless a file can be written, which would replace none of the inputs.

    Commands call it before they compute.
    """
    if path is None:
        return
    if os.path.realpath(path) in (os.path.realpath(file) for file in inputs if file is not None):
        raise click.BadParameter(f"{path} would replace what is read", param_hint="--output")
    folder = path.absolute().parent
    if not folder.is_dir():
        raise click.BadParameter(f"{path} must be in an existing folder", param_hint="--output")
    if not os.access(path if path.exists() else folder, os.W_OK):
        raise click.BadParameter(f"{path} can't be written", param_hint="--output")

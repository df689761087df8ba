"""The command: its group of subcommands, and the exit codes of errors."""

import sys
from collections.abc import Sequence
from concurrent.futures import BrokenExecutor

import click

from cg.command.methods import export_command, list_command, show_command
from cg.command.proving import certify_command, check_command
from cg.command.searching import construct_command, search_command
from cg.support.flint import MissingFlintError
from cg.support.parsing import visible

UNUSABLE, MISSING, INTERRUPTED = 2, 3, 130  # exit codes: wrong argument, missing package, interrupt

PROGRAM = "crouch-grossman"
_REFUSED = (
    click.ClickException, ArithmeticError, BrokenExecutor, MemoryError, MissingFlintError, OSError,
    TypeError, ValueError,  # TypeErrors refuse kinds of methods
)  # fmt: skip


@click.group(
    commands=[
        list_command, show_command, check_command, search_command, construct_command,
        certify_command, export_command,
    ],
    context_settings={
        "help_option_names": ["-h", "--help"], "max_content_width": 100, "show_default": True
    },
    epilog="Exit codes: 0 for success, 1 for a negative result, 2 for a wrong argument, 3 without "
    "a package that the command needs, 130 after an interrupt. Every command that prints data "
    "takes --json.",
)  # fmt: skip
@click.version_option(package_name=PROGRAM, prog_name=PROGRAM, message="%(prog)s %(version)s")
def group() -> None:
    """Runge–Kutta methods on manifolds: find, check, construct, prove and export them.

    \b
    Examples:
      crouch-grossman list --order 5 --pair
      crouch-grossman show CF5a
      crouch-grossman check my_method.toml
    """


def main(
    arguments: Sequence[str] | None = None, *, program: str = PROGRAM,
    command: click.Command = group,
) -> int:  # fmt: skip
    """Run a command with the arguments of the process, or others; return the exit code."""
    try:
        if sys.stdout is None:  # closed, so that click would print nothing
            raise OSError("standard output must be open")
        code = command.main(arguments, prog_name=program, standalone_mode=False)
    except (click.Abort, KeyboardInterrupt) as end:
        print(f"{program}: {_with_notes('interrupted', end.__cause__ or end)}", file=sys.stderr)
        return INTERRUPTED
    except click.exceptions.NoArgsIsHelpError as error:
        click.echo(error.format_message())
        return 0
    except _REFUSED as error:
        text = error.format_message() if isinstance(error, click.ClickException) else str(error)
        text = visible(" ".join(_with_notes(text, error).split()))
        print(f"{program}: error: {text}", file=sys.stderr)
        return MISSING if isinstance(error, MissingFlintError) else UNUSABLE
    return code if isinstance(code, int) else 0


def _with_notes(text: str, error: BaseException) -> str:
    """Return the message of an error with the notes added to it."""
    return "; ".join([text, *getattr(error, "__notes__", ())])

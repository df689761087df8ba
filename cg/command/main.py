"""The command: its group, its subcommands, and the exit codes of errors."""

import sys
from collections.abc import Sequence
from concurrent.futures import BrokenExecutor
from importlib import import_module

import click

from cg.support.flint import MissingFlintError
from cg.support.parsing import visible

NO, UNUSABLE, MISSING, INTERRUPTED = 1, 2, 3, 130
"""Exit codes: negative result, wrong argument, missing package, interrupt."""

PROGRAM = "crouch-grossman"
_REFUSED = (
    click.ClickException, ArithmeticError, BrokenExecutor, MemoryError, MissingFlintError, OSError,
    ValueError,
)  # fmt: skip
_IN_COMMAND = {
    "pass force=True": "pass --force",
    "pass certificate=cg.certify(method)": "crouch-grossman certify FILE -o PROOF makes one; "
    "name it like FILE with .certificate.toml at its end, or pass export --certificate PROOF",
    "valid integer range": "valid integer",
    "valid float": "valid number",
}
"""Words of messages of Python functions and of click, and the words that the command uses."""

_MODULES = {
    "list": "methods",
    "show": "methods",
    "check": "proving",
    "search": "searching",
    "construct": "searching",
    "certify": "proving",
    "export": "methods",
}


class _Commands(click.Group):
    """A group whose subcommands are imported when they are run."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        return list(_MODULES)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        if cmd_name not in _MODULES:
            if not (cmd_name.startswith("-") or ctx.resilient_parsing):
                from cg.support.checks import similar_names  # late: it imports NumPy

                ctx.fail(f"no command is named {cmd_name!r}{similar_names(cmd_name, _MODULES)}")
            return None
        module = import_module(f"cg.command.{_MODULES[cmd_name]}")
        command: click.Command = getattr(module, f"{cmd_name}_command")
        return command


@click.group(
    cls=_Commands,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100},
    epilog="Exit codes: 0 for success, 1 for a negative result, 2 for a wrong argument, 3 without "
    "a package that the command needs, 130 after an interrupt. Every command that prints data "
    "takes --json.",
)
@click.version_option(
    package_name=PROGRAM,
    prog_name=PROGRAM,
    message="%(prog)s %(version)s",
    help="Print the version and exit.",
)
def group() -> None:
    """Runge–Kutta methods on manifolds: find, check, construct, prove and export them.

    \b
    Examples:
      crouch-grossman list --order 5 --sort flows
      crouch-grossman show CF5a
      crouch-grossman check my_method.toml
    """


def main(
    arguments: Sequence[str] | None = None,
    *,
    program: str = PROGRAM,
    command: click.Command = group,
) -> int:
    """Run a command with the arguments of the process, or others; return the exit code."""
    try:
        code = command.main(arguments, prog_name=program, standalone_mode=False)
    except (click.Abort, KeyboardInterrupt) as end:
        print(f"{program}: {_with_notes('interrupted', end.__cause__ or end)}", file=sys.stderr)
        return INTERRUPTED
    except click.exceptions.NoArgsIsHelpError as error:
        click.echo(error.ctx.get_help() if error.ctx else "")
        return 0
    except _REFUSED as error:
        message = _with_notes(message_of(error), error)
        for words, words_of_command in _IN_COMMAND.items():
            message = message.replace(words, words_of_command)
        print(f"{program}: error: {visible(' '.join(message.split()))}", file=sys.stderr)
        return MISSING if isinstance(error, MissingFlintError) else UNUSABLE
    return code if isinstance(code, int) else 0


def message_of(error: Exception) -> str:
    """Return the message of an error; for errors of files the path and what is wrong."""
    if isinstance(error, click.ClickException):
        return error.format_message()
    if isinstance(error, MemoryError):
        return f"not enough memory: {error}"
    if isinstance(error, OSError) and error.filename:
        return f"{error.filename}: {error.strerror}"
    return str(error)


def _with_notes(text: str, error: BaseException) -> str:
    """Return the message of an error with the notes added to it."""
    return "; ".join([text, *getattr(error, "__notes__", ())])

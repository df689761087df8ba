"""``reproduce``: reproduction of the paper."""

from __future__ import annotations

import click

__all__ = ["reproduce_command"]


@click.command(
    "reproduce",
    short_help="Reproduce the paper.",
    context_settings={"ignore_unknown_options": True, "help_option_names": []},
    add_help_option=False,
)
@click.argument("arguments", nargs=-1, type=click.UNPROCESSED)
def reproduce_command(arguments: tuple[str, ...]) -> int:
    """Reproduce the paper; the same as reproduce-paper, with its options.

    \b
    Examples:
      crouch-grossman reproduce --list
      crouch-grossman reproduce --only fig4.1 --out report
    """
    from ..reproduce.main import main

    try:
        return int(main(arguments))
    except SystemExit as end:  # its parser has printed why
        return end.code if isinstance(end.code, int) else 0

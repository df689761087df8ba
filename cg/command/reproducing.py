"""``reproduce``: the paper."""

from __future__ import annotations

from importlib import import_module

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
    main = import_module("cg.reproduce.main").main  # in the source tree it isn't below cg
    try:
        return int(main(arguments))
    except SystemExit as end:  # of its parser, which has said why
        return end.code if isinstance(end.code, int) else 0

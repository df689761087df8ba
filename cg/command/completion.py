"""``completion``: what a shell reads to complete commands, options and names of methods."""

from __future__ import annotations

import click
from click.shell_completion import get_completion_class

from .main import COMPLETE, PROGRAM, group

__all__ = ["completion_command"]


@click.command("completion", short_help="Print the completion of a shell.")
@click.argument("shell", type=click.Choice(["bash", "zsh", "fish"]))
def completion_command(shell: str) -> None:
    """Print the completion of a shell, which completes names of methods too.

    \b
    Examples:
      eval "$(crouch-grossman completion bash)"       # in ~/.bashrc
      eval "$(crouch-grossman completion zsh)"        # in ~/.zshrc
      crouch-grossman completion fish > ~/.config/fish/completions/crouch-grossman.fish
    """
    kind = get_completion_class(shell)
    assert kind is not None
    click.echo(kind(group, {}, PROGRAM, COMPLETE).source())

"""``completion``: shell scripts that complete commands, options and names of methods."""

import click
from click.shell_completion import get_completion_class

from cg.command.main import COMPLETE, PROGRAM, group


@click.command("completion", short_help="Print a completion script for a shell.")
@click.argument("shell", type=click.Choice(["bash", "zsh", "fish"]))
def completion_command(shell: str) -> None:
    """Print a script for a shell that completes commands, options and names of methods.

    \b
    Examples:
      eval "$(crouch-grossman completion bash)"       # in ~/.bashrc
      eval "$(crouch-grossman completion zsh)"        # in ~/.zshrc
      crouch-grossman completion fish > ~/.config/fish/completions/crouch-grossman.fish
    """
    kind = get_completion_class(shell)
    assert kind is not None
    click.echo(kind(group, {}, PROGRAM, COMPLETE).source())

"""``completion``: shell scripts that complete commands, options and names of methods."""

import click
from click.shell_completion import BashComplete, get_completion_class

from cg.command.main import COMPLETE, PROGRAM, group

_BASH = """\
%(complete_func)s() {
    local IFS=$'\\n' type value
    while IFS=, read -r type value; do
        case $type in
            plain)
                COMPREPLY+=("$value")
                # as in names of files, readline quotes parentheses
                [[ $value == *[\\(\\)]* ]] && compopt -o filenames ;;
            file)
                mapfile -t -O ${#COMPREPLY[@]} COMPREPLY < <(compgen -f -- "$value")
                compopt -o default -o filenames ;;
        esac
    done < <(env COMP_WORDS="${COMP_WORDS[*]}" COMP_CWORD=$COMP_CWORD \\
        %(complete_var)s=bash_complete "$1")
}

complete -o nosort -F %(complete_func)s %(prog_name)s
"""


class _Bash(BashComplete):
    """Completion that quotes names with parentheses, and proposes names and files together."""

    source_template = _BASH


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
    kind = _Bash if shell == "bash" else get_completion_class(shell)
    assert kind is not None
    click.echo(kind(group, {}, PROGRAM, COMPLETE).source())

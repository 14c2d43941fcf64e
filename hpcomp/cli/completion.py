"""`hpcomp completion`: prints the script that teaches a shell hpcomp's commands and options."""

from __future__ import annotations

import click
from click.shell_completion import get_completion_class

from .options import Choice, Command, print_data


@click.command("completion", cls=Command, short_help="Print the completion script of a shell.")
@click.argument("shell", type=Choice(["bash", "zsh", "fish"], "shell"))
def command(shell: str) -> None:
    """Print the completion script of a shell.

    \b
      bash  eval "$(hpcomp completion bash)" in ~/.bashrc
      zsh   eval "$(hpcomp completion zsh)" in ~/.zshrc
      fish  hpcomp completion fish > ~/.config/fish/completions/hpcomp.fish
    """
    from . import COMPLETING, cli

    kind = get_completion_class(shell)
    assert kind is not None
    print_data(kind(cli, {}, "hpcomp", COMPLETING).source())

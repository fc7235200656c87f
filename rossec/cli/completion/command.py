"""`rossec completion SHELL`: the script that makes Tab complete names."""

import shutil
import sys
from pathlib import Path

import click

from rossec.cli.completion.shells import SHELLS, script
from rossec.terminal import say_block


@click.command()
@click.argument("shell", type=click.Choice(SHELLS))
def completion(shell: str) -> None:
    """Print what makes Tab complete commands and names in SHELL: bash, zsh or fish.

    For bash, add this line to ~/.bashrc; for zsh, with zsh for bash, to ~/.zshrc behind compinit:

    \b
      eval "$(rossec completion bash)"

    For fish, once:

    \b
      rossec completion fish > ~/.config/fish/completions/rossec.fish

    Names are those in ROSSEC_HOME, of what the last look at the graph showed (rossec topic list),
    and of the ROS packages here. Tab asks no master and no person.
    """
    say_block(script(shell, _program()).rstrip())


def _program() -> str:
    """The path of this program: Tab runs no other; else by name, as of a program on PATH."""
    path = Path(sys.argv[0])
    if path.name != "rossec":
        return "rossec"
    found = shutil.which(path)
    return "rossec" if found is None else str(Path(found).absolute())

"""Every command that can be typed, from the tables of the groups."""

from collections.abc import Iterator

import click

from rossec.cli.main import rossec
from rossec.cli.shared.context import LazyCommand


def commands(root: click.Command = rossec, path: tuple[str, ...] = ()) -> Iterator[tuple[str, click.Command]]:
    """Each command that runs, with its words; a group only if it runs without a verb."""
    command = root.load() if isinstance(root, LazyCommand) else root
    if not isinstance(command, click.Group):
        yield " ".join(path), command
        return
    if command.invoke_without_command:
        yield " ".join(path), command
    for name, below in command.commands.items():
        yield from commands(below, (*path, name))


def options(command: click.Command) -> set[str]:
    """The options of a command."""
    return {option for parameter in command.params for option in parameter.opts}

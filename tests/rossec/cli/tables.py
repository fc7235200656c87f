"""What the table of a lazy group has to hold."""

from collections.abc import Iterator

import click

from rossec.cli.shared.lazy import LazyCommand, LazyGroup


def check_table(group: click.Command) -> None:
    """Every command exists under its name, and is listed with its own help line."""
    assert isinstance(group, LazyGroup)
    assert group.commands
    for name, listed in group.commands.items():
        assert isinstance(listed, LazyCommand)
        command = listed.load()
        assert command.name == name
        assert not command.hidden
        assert listed.help is not None
        assert listed.get_short_help_str() == listed.help
        assert (command.help or "").replace("\n", " ").startswith(listed.help)


def all_commands(
    group: click.Group, path: tuple[str, ...] = ("rossec",)
) -> Iterator[tuple[tuple[str, ...], LazyCommand | None, click.Command]]:
    """Every command: its words, how it is listed, and itself; the group first."""
    yield path, None, group
    for name, listed in group.commands.items():
        command = listed.load() if isinstance(listed, LazyCommand) else listed
        lazy = listed if isinstance(listed, LazyCommand) else None
        if isinstance(command, click.Group):
            yield from all_commands(command, (*path, name))
        else:
            yield (*path, name), lazy, command

"""What the table of a lazy group has to hold."""

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
        for width in (20, 45, 80, 1000):
            assert listed.get_short_help_str(width) == command.get_short_help_str(width)
        assert listed.help is not None
        assert (command.help or "").replace("\n", " ").startswith(listed.help)

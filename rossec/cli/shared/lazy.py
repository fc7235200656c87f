"""Groups whose commands are imported when they run: help and completion list them unimported."""

import importlib
from collections.abc import Mapping
from typing import Any

import click


class LazyCommand(click.Command):
    """A command that is listed: its name, its help line, and the place it is imported from."""

    def __init__(self, name: str, place: str, help_line: str) -> None:
        """`place` is "module:attribute" below `rossec.cli`."""
        super().__init__(name, help=help_line)
        self.place = place

    def get_short_help_str(self, limit: int = 45) -> str:  # noqa: ARG002 - as the base has it
        """The whole help line: the list wraps it, click would cut it."""
        return self.help or ""

    def load(self) -> click.Command:
        """The command itself."""
        module, _, attribute = self.place.partition(":")
        command: click.Command = getattr(importlib.import_module(f"rossec.cli.{module}"), attribute)
        return command

    def outlined(self) -> click.Command:
        """The command as far as completion needs it; a group as it is."""
        from rossec.cli.completion.lookup import completed  # noqa: PLC0415 - for completion alone

        return completed(self.name or "", self.place, self.load)


class LazyGroup(click.Group):
    """A group made from a table: name -> (place, help line), see `LazyCommand`."""

    def __init__(self, *args: Any, table: Mapping[str, tuple[str, str]], **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        for name, (place, help_line) in table.items():
            self.add_command(LazyCommand(name, place, help_line))

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """The command that is to run; to be completed, one that knows its parameters alone."""
        name, command, rest = super().resolve_command(ctx, args)
        if isinstance(command, LazyCommand):
            command = command.outlined() if ctx.resilient_parsing else command.load()
        return name, command, rest

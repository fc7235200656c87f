"""The command to be completed, made of its outline, with names for its arguments. A shell."""

from collections.abc import Callable
from functools import partial
from typing import Any, Final

import click
from click.shell_completion import CompletionItem

from ca.errors import HintedError
from rossec.cli.completion.outline import Outline, Values, command_of, outline_of
from rossec.cli.completion.outline_table import OutlineTable
from rossec.cli.completion.values import COMMAND, FREE, KINDS, kinds_of
from rossec.cli.completion.words import offered

_FILES: Final = [CompletionItem("", type="file")]  # the shell looks them up


def completed(
    name: str, place: str, load: Callable[[], click.Command], table: OutlineTable | None = None
) -> click.Command:
    """The command `name` at `place`, to be completed; `load` imports it if that is needed."""
    loaded: list[click.Command] = []

    def make() -> Outline | None:
        loaded.append(load())
        return None if isinstance(loaded[0], click.Group) else outline_of(loaded[0])

    outline = (table or OutlineTable()).get(place, make)
    if outline is None:
        return loaded[0]
    return command_of(name, outline, [*map(_values, kinds_of(place, outline))])


def _values(kind: str) -> Values | None:
    return None if kind == FREE else partial(_offer, kind)


def _offer(
    kind: str, context: click.Context, _param: click.Parameter, incomplete: str
) -> list[CompletionItem[Any]]:
    """The names of a kind that begin with what is typed."""
    if kind == COMMAND:
        return _FILES
    from rossec.cli.completion.sources import Sources  # noqa: PLC0415 - not needed for options

    environment = context.obj
    try:
        sources = Sources(environment.home, environment.variables)
    except HintedError:  # a home that others could have written
        return []
    found = [word for read in KINDS[kind] for word in read(sources)]
    return [CompletionItem(word) for word in offered(found, incomplete)]

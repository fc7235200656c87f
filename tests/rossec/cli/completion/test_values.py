from operator import methodcaller

import click
import pytest

from rossec.cli.completion.sources import Sources
from rossec.cli.completion.values import FREE, KINDS, OPTIONS, kinds_of, outline_of
from rossec.cli.main import rossec
from rossec.cli.shared.context import LazyCommand
from tests.rossec.cli.tables import all_commands

LISTED = {
    listed.place: (listed, command) for _, listed, command in all_commands(rossec) if listed is not None
}
LEAVES = {place: command for place, (_, command) in LISTED.items() if not isinstance(command, click.Group)}
ARGUMENTS = {place: listed.arguments for place, (listed, _) in LISTED.items()}


def texts(command: click.Command) -> int:
    params = outline_of(command)["params"]
    return sum(1 for each in params if each.get("text") and "opts" not in each)


@pytest.mark.parametrize("place", sorted(LEAVES))
def test_every_argument_that_is_text_has_its_kind(place: str) -> None:
    """The table of its group says for a new one which names it takes, or `FREE`."""
    assert texts(LEAVES[place]) == len(ARGUMENTS[place])


def test_every_option_is_of_a_command() -> None:
    options = {name for command in LEAVES.values() for each in command.params for name in each.opts}
    assert OPTIONS.keys() <= options


def test_every_kind_can_be_read(tmp_path: object) -> None:
    used = {kind for kinds in ARGUMENTS.values() for kind in kinds} | set(OPTIONS.values())
    assert used <= KINDS.keys()
    methods = {read.__reduce__()[1][0] for reads in KINDS.values() for read in reads}
    assert all(callable(getattr(Sources, name)) for name in methods)
    assert {type(read) for reads in KINDS.values() for read in reads} == {methodcaller}


def kinds(place: str) -> dict[str, str]:
    outline = outline_of(LEAVES[place])
    names = [each.get("opts", [each["name"]])[0] for each in outline["params"]]
    return dict(zip(names, kinds_of(place, ARGUMENTS[place], outline), strict=True))


def test_arguments_and_options_get_theirs() -> None:
    found = kinds("ros.topic:echo")
    assert [found[name] for name in ("name", "type_name", "--as")] == ["topic", "message type", "own node"]
    assert found["--count"] == FREE
    assert [kinds("sites:add_relay")[name] for name in ("label", "file")] == [FREE, FREE]


def test_an_option_may_mean_something_else_in_one_command() -> None:
    assert kinds("sites:add_site")["--as"] == FREE
    assert kinds("ros.calls:call")["--type"] == "service type"


def test_the_places_are_those_of_the_tables() -> None:
    assert isinstance(rossec.commands["ca"], LazyCommand)
    assert "ca.home:init" in LEAVES

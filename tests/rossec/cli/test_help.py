"""`--help` of every command fits a terminal of 80 columns, and cuts nothing."""

import click
import pytest

from rossec.cli.main import rossec
from tests.rossec.cli.tables import all_commands

COMMANDS = {words: command for words, _, command in all_commands(rossec)}


def help_of(words: tuple[str, ...]) -> str:
    context = click.Context(COMMANDS[words], info_name=" ".join(words), terminal_width=80)
    return COMMANDS[words].get_help(context)


@pytest.mark.parametrize("words", COMMANDS, ids=" ".join)
def test_help_fits_80_columns(words: tuple[str, ...]) -> None:
    assert [line for line in help_of(words).splitlines() if len(line) > 80] == []


@pytest.mark.parametrize("words", COMMANDS, ids=" ".join)
def test_no_summary_is_cut(words: tuple[str, ...]) -> None:
    command = COMMANDS[words]
    if isinstance(command, click.Group):
        said = " ".join(help_of(words).split())
        for name in command.list_commands(click.Context(command)):
            found, line = COMMANDS[*words, name], command.commands[name].get_short_help_str()
            assert not found.hidden
            assert line, f"{' '.join(words)} {name} has no help line"
            assert " ".join((found.help or "").split()).startswith(line)
            assert f"{name} {line}" in said


@pytest.mark.parametrize("words", COMMANDS, ids=" ".join)
def test_every_option_says_what_it_is(words: tuple[str, ...]) -> None:
    options = (each for each in COMMANDS[words].params if isinstance(each, click.Option))
    assert [each.opts for each in options if not each.help and not each.hidden] == []

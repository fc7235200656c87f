import sys

import click
import pytest

from rossec.cli.shared.context import LazyGroup

HELP = "Look for the masters of this trust domain, the best link first."
MODULE = "rossec.cli.ros.graph"


@pytest.fixture
def group(monkeypatch: pytest.MonkeyPatch) -> LazyGroup:
    made = LazyGroup("group", table={"discover": "ros.graph:discover"})
    made.get_help(click.Context(made))  # in a source tree the first look imports, and keeps the outline
    monkeypatch.delitem(sys.modules, MODULE, raising=False)
    return made


def test_a_command_is_listed_without_an_import(group: LazyGroup) -> None:
    said = group.get_help(click.Context(group, terminal_width=60))
    assert " ".join(said.split()).endswith(f"discover {HELP}")
    assert max(map(len, said.splitlines())) <= 60
    assert [item.value for item in group.shell_complete(click.Context(group), "dis")] == ["discover"]
    assert MODULE not in sys.modules


def test_a_command_is_imported_to_run(group: LazyGroup, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        group.main(["discover", "--help"])
    assert "--seconds" in capsys.readouterr().out
    assert MODULE in sys.modules


def test_a_similar_command_is_suggested(group: LazyGroup) -> None:
    with pytest.raises(click.UsageError) as caught:
        group.main(["discovr"], standalone_mode=False)
    assert "Did you mean 'discover'?" in caught.value.format_message()


def test_a_command_of_its_own_is_as_in_any_group(group: LazyGroup) -> None:
    done: list[str] = []
    group.add_command(click.Command("here", callback=lambda: done.append("here")))
    group.main(["here"], standalone_mode=False)
    assert done == ["here"]

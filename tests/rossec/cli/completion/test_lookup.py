from pathlib import Path

import click
import pytest
from click.shell_completion import ShellComplete

from rossec.cli.completion.shells import OutlineTable, completed
from rossec.cli.shared.context import Environment


@click.command()
@click.argument("node")
@click.option("--as", "own")
def hz(**_values: object) -> None:
    raise AssertionError("completion runs nothing")


def table(tmp_path: Path) -> OutlineTable:
    if not (tmp_path / "main.py").exists():
        (tmp_path / "main.py").touch()
    return OutlineTable(tmp_path / "no", tmp_path / "__pycache__" / "outlines.json", tmp_path)


@pytest.fixture
def home(tmp_path: Path) -> Path:
    path = tmp_path / "home"
    (path / "nodes" / "robot1.camera").mkdir(parents=True)
    (path / "nodes" / "a b").mkdir()
    path.chmod(0o700)
    return path


def offered(command: click.Command, home: Path, *words: str) -> list[tuple[str, str]]:
    environment = Environment({"ROSSEC_HOME": str(home)})
    complete = ShellComplete(command, {"obj": environment}, "x", "X")
    return [(i.value, i.type) for i in complete.get_completions([*words[:-1]], words[-1])]


def test_names_are_offered_for_their_arguments(tmp_path: Path, home: Path) -> None:
    command = completed("hz", "grant.sign:sign", lambda: hz, ("node",), table(tmp_path))
    assert offered(command, home, "") == [("/robot1/camera", "plain")]
    assert offered(command, home, "--as", "/r") == [("/robot1/camera", "plain")]
    assert offered(command, home, "--as", "/x") == []


def test_a_command_that_is_known_is_not_imported(tmp_path: Path, home: Path) -> None:
    completed("hz", "grant.sign:sign", lambda: hz, ("node",), table(tmp_path))
    command = completed("hz", "grant.sign:sign", lambda: pytest.fail("imported"), ("node",), table(tmp_path))
    assert offered(command, home, "--a") == [("--as", "plain")]


def test_a_group_is_completed_as_it_is(tmp_path: Path) -> None:
    group = click.Group("ca")
    assert completed("ca", "nouns:ca", lambda: group, (), table(tmp_path)) is group


def test_a_program_is_looked_up_by_the_shell(tmp_path: Path, home: Path) -> None:
    command = completed("run", "node.sidecar:run", lambda: hz, ("command",), table(tmp_path))
    assert offered(command, home, "./") == [("", "file")]


def test_a_home_that_others_could_have_written_gives_nothing(tmp_path: Path, home: Path) -> None:
    home.chmod(0o777)
    command = completed("hz", "grant.sign:sign", lambda: hz, ("node",), table(tmp_path))
    assert offered(command, home, "") == []

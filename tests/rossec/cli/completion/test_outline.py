import json
from pathlib import Path

import click
import pytest
from click.shell_completion import CompletionItem, ShellComplete

from rossec.cli.completion.values import command_of, outline_of


@click.command(context_settings={"allow_interspersed_args": False})
@click.argument("name")
@click.argument("files", nargs=-1, type=click.Path(path_type=Path, exists=True))
@click.option("--as", "node", required=True, help="identity to use")
@click.option("--mode", type=click.Choice(["fast", "slow"]))
@click.option("--to", type=click.Path(file_okay=False))
@click.option("--yes/--no", "-y", default=False, help="do not ask")
@click.option("--verbose", "-v", count=True)
@click.option("--pair", nargs=2, multiple=True)
@click.option("--secret", hidden=True)
def example(**_values: object) -> None:
    raise AssertionError("completion runs nothing")


def again() -> click.Command:
    outline = json.loads(json.dumps(outline_of(example)))
    values = [
        (lambda context, param, typed, each=each: [f"{each['name']}1"]) if each.get("text") else None
        for each in outline["params"]
    ]
    return command_of("example", outline, values)


def completed(command: click.Command, *words: str) -> list[CompletionItem[str]]:
    return ShellComplete(command, {}, "x", "X").get_completions([*words[:-1]], words[-1])


@pytest.mark.parametrize(
    "words",
    [
        ("-",),
        ("--",),
        ("--y",),
        ("a", "-"),
        ("--mode", ""),
        ("--mode=f",),
        ("--to", ""),
        ("a", ""),
        ("--yes", "--"),
        ("-v", "--"),
        ("--pair", "1", "2", "--p"),
    ],
)
def test_a_command_of_an_outline_is_completed_as_the_real_one(words: tuple[str, ...]) -> None:
    found = [(item.value, item.type) for item in completed(again(), *words)]
    assert sorted(found) == sorted((item.value, item.type) for item in completed(example, *words))
    assert found


def test_names_complete_text_alone() -> None:
    assert [item.value for item in completed(again(), "")] == ["name1"]
    assert [item.value for item in completed(again(), "--as", "")] == ["node1"]
    assert [item.value for item in completed(again(), "--pair", "")] == ["pair1"]
    assert [item.type for item in completed(again(), "a", "")] == ["file"]


def test_what_is_hidden_stays_so() -> None:
    assert "secret" not in json.dumps(outline_of(example))


def test_what_is_no_outline_makes_no_command() -> None:
    with pytest.raises(KeyError):
        command_of("x", {}, [])

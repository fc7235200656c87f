"""`--json` for every result: each command has it, or a reason why not, and its keys are written."""

import ast
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Final

from rossec.cli.shared import options as results
from tests.rossec.cli.walk import commands, options

ROOT: Final = Path(__file__).parents[3]
SPEC: Final = (ROOT / "docs/spec/results.md").read_text()

_FILE: Final = "prints a file, to be redirected"
_GOES_ON: Final = "goes on until it is stopped; figures for people"
WITHOUT: Final = {
    "ca log prove": "its result is JSON",
    "completion": "prints a program of the shell",
    "demo": "a performance for people",
    "namespace rules": _FILE,
    "policy import-sros2": _FILE,
    "policy review": "a conversation with a person",
    "relay descriptor": _FILE,
    "router accounts add": _FILE,
    "router accounts show": _FILE,
    "router share": _FILE,
    "run": "becomes another program",
    "sidecar": "becomes another program",
    "topic bw": _GOES_ON,
    "topic hz": _GOES_ON,
    "topic pub": "sends until it is stopped; it has no result",
}


def test_every_command_prints_json_or_there_is_a_reason() -> None:
    without = {words for words, command in commands() if "--json" not in options(command)}
    assert without == set(WITHOUT)


def acting() -> set[str]:
    """Commands whose document is what they record."""
    return {
        words
        for words, command in commands()
        for parameter in command.params
        if getattr(parameter, "help", "") == results.HELP
    }


def documented() -> set[str]:
    section = SPEC.partition("## Commands that act")[2].partition("\n## ")[0]
    rows = re.findall(r"^\| (`.+?`) \|", section, re.MULTILINE)
    return {name for row in rows for name in re.findall(r"`(.+?)`", row)}


def test_every_command_that_acts_is_in_the_specification() -> None:
    assert acting() == documented()
    assert len(acting()) > 50


def test_every_reason_is_in_the_specification() -> None:
    section = SPEC.partition("## Without `--json`")[2]
    assert set(WITHOUT) <= set(re.findall(r"`([a-z0-9 -]+)`", section))


def recorded(path: Path) -> Iterator[str]:
    for node in ast.walk(ast.parse(path.read_text())):
        match node:
            case ast.Call(func=ast.Name(id="record"), keywords=keywords):
                yield from (each.arg for each in keywords if each.arg is not None)
            case ast.Call(func=ast.Name(id="add_entry"), args=[ast.Constant(value=key), facts]):
                yield str(key)
                if isinstance(facts, ast.Dict):
                    yield from (str(each.value) for each in facts.keys if isinstance(each, ast.Constant))
            case _:
                pass


def test_every_key_is_in_the_specification() -> None:
    sources = sorted((ROOT / "rossec" / "cli").rglob("*.py"))
    keys = {key for path in sources for key in recorded(path)}
    written = set(re.findall(r"`([a-z_]+)`", SPEC))
    assert keys - written == set()
    assert {"results", "published", "given", "name", "key"} <= keys | {"results"}


def several() -> set[str]:
    """Commands that take one name or more and go through a batch."""
    section = SPEC.partition("## Commands over several names")[2].partition("\n\n")[0]
    return set(re.findall(r"`([a-z ]+)`", section))


def test_commands_over_several_names_are_those_of_the_specification() -> None:
    repeated = {
        words
        for words, command in commands()
        if words in acting()
        for parameter in command.params
        if parameter.param_type_name == "argument" and parameter.nargs == -1
    }
    others = {"border labels", "node labels", "grant decide", "node confirm"}
    others |= {"param set"}  # its value, if a shell took it apart: an error that says so
    assert repeated - others == several()

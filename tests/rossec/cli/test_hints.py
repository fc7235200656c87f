"""A hint never names a command that fails.

What stands in messages as `rossec ...` is held against click's own tables. In backquotes, and in
help texts, a command may be named without its arguments; anywhere else it is there to be typed: it
has its verb, and every argument and option that it needs, as a placeholder at least.
"""

import ast
import re
import shlex
from collections.abc import Iterator
from pathlib import Path
from typing import Final

import click
import pytest

from rossec.cli.main import rossec
from rossec.cli.shared.context import LazyCommand
from tests.rossec.cli.tables import all_commands

ROOT: Final = Path(__file__).parents[3]
SOURCES: Final = sorted(path for name in ("ca", "grants", "rossec") for path in (ROOT / name).rglob("*.py"))
VALUE: Final = "\ufffc"  # what an f-string puts in
OTHERS: Final = frozenset(
    {
        "policy",  # the title of the schema
        "gateway --from hospital /robot/pose",  # its own syntax: tests/rossec/cli/gateway
    }
)
PROSE: Final = frozenset(
    {  # "rossec" as the subject of a sentence, and in names
        "again",
        "an",
        "background",
        "before",
        "busy",
        "by",
        "code",
        "codes",
        "connection",
        "deposits",
        "described",
        "end",
        "labels",
        "layout",
        "manual",
        "overlay",
        "parameters",
        "reads",
        "region",
        "report",
        "routers",
        "runs",
        "send",
        "supports",
    }
)
_NAMED: Final = re.compile(r"(`?)\brossec (?=[a-z])(?=([^\n`]*))")
_ARGUMENT: Final = re.compile(rf"-|[A-Z]|{VALUE}|['/.0-9]|\S*[.:/=]\S")
_END: Final = re.compile(r"[,;:)?!]+$|[.]$")


def texts(path: Path) -> Iterator[tuple[int, str]]:
    """Strings of a module that are no docstrings."""
    tree = ast.parse(path.read_text())
    documents = {
        id(node.body[0].value)
        for node in ast.walk(tree)
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef)
        and node.body
        and isinstance(node.body[0], ast.Expr)
    }
    documents |= {
        id(node.args[1])
        for node in ast.walk(tree)
        if isinstance(node, ast.Call)
        and getattr(node.func, "attr", getattr(node.func, "id", "")) in ("option", "flag", "duration")
        and len(node.args) == 2
    }  # `helps` has them
    parts = {id(part) for node in ast.walk(tree) if isinstance(node, ast.JoinedStr) for part in node.values}
    for node in ast.walk(tree):
        if isinstance(node, ast.JoinedStr):
            yield (
                node.lineno,
                "".join(str(part.value) if isinstance(part, ast.Constant) else VALUE for part in node.values),
            )
        elif isinstance(node, ast.Constant) and id(node) not in documents | parts:
            yield node.lineno, str(node.value)


def helps() -> Iterator[tuple[str, str]]:
    """Help of the commands and of their options."""
    for words, _, command in all_commands(rossec):
        yield " ".join(words), command.help or ""
        for param in command.params:
            yield " ".join(words), getattr(param, "help", "") or ""


def words_of(text: str) -> Iterator[str]:
    """The words of a command at the beginning of a text, without the prose behind it."""
    previous = ""
    for number, word in enumerate(text.split(" ")):
        bare = _END.sub("", word)
        if word == "--":
            yield from text.split(" ")[number:]
            return
        if number > 2 and not _ARGUMENT.match(bare) and previous[:1] != "-":
            return
        yield (previous := bare)
        if bare != word:
            return


class Named:
    """A command that a text names: how far its words lead, and what is left of them."""

    def __init__(self, quoted: str, text: str) -> None:
        self.is_name = bool(quoted)
        self.group: click.Group | None = None
        self.command: click.Command = rossec
        self.rest = [*words_of(text)]
        while isinstance(self.command, click.Group) and self.rest:
            if (found := self.command.commands.get(self.rest[0])) is None:
                break
            self.group, self.command = self.command, loaded(found)
            self.rest.pop(0)

    def arguments(self) -> list[str]:
        """What the text gives the command."""
        found: list[str] = []
        for number, word in enumerate(self.rest):
            if word == "--":
                return [*found, *self.rest[number:]]
            if not _ARGUMENT.match(word):
                previous = self._option(found[-1]) if found else None
                if previous is None or previous.is_flag:
                    break
            found.append(word)
        return found

    def _option(self, word: str) -> click.Option | None:
        options = (each for each in self.command.params if isinstance(each, click.Option))
        return next((each for each in options if word in each.opts), None)

    def mistake(self) -> str:
        """What click would say; empty if the command can be run."""
        arguments = self.arguments()
        if (self.is_name and not arguments) or f"--{VALUE}" in arguments:
            return ""
        if isinstance(self.command, click.Group) and not self.command.invoke_without_command:
            return "" if self.is_name else f"no verb of {self.command.name}: {self.rest}"
        if "--help" in arguments:
            return ""
        context = click.Context(self.command, info_name="rossec")
        try:
            given, left, _ = self.command.make_parser(context).parse_args(
                [word for each in arguments for word in shlex.split(each.replace("'", ""))]
            )
        except click.UsageError as error:
            return error.format_message()
        if left and VALUE not in "".join(arguments):
            return f"too many arguments: {left}"
        present = str, list, tuple, int
        missing = [
            each.name
            for each in self.command.params
            if each.required and not isinstance(given.get(each.name or ""), present)
        ]
        return f"missing: {missing}" if missing and VALUE * 2 not in "".join(arguments) else ""


def loaded(command: click.Command) -> click.Command:
    return command.load() if isinstance(command, LazyCommand) else command


def named() -> Iterator[tuple[str, str, str]]:
    for path in SOURCES:
        for line, text in texts(path):
            for match in _NAMED.finditer(text):
                yield f"{path.relative_to(ROOT)}:{line}", match[1], match[2]
    for where, text in helps():
        for match in _NAMED.finditer(" ".join(text.split())):
            yield f"{where} --help", "`", match[2]


def is_command(text: str) -> bool:
    return re.split("[^a-z]", text)[0] not in PROSE and text not in OTHERS


def test_every_command_in_a_message_can_be_run() -> None:
    mistakes = [
        f"{where}: rossec {text}: {found}"
        for where, quoted, text in named()
        if is_command(text)
        if (found := Named(quoted, text).mistake())
    ]
    assert mistakes == []


def test_every_command_of_the_readme_and_the_examples_exists() -> None:
    lines = [
        line.removeprefix("rossec ")
        for path in (ROOT / "README.md", *ROOT.glob("examples/*.sh"))
        for line in path.read_text().splitlines()
        if line.startswith("rossec ") and is_command(line.removeprefix("rossec "))
    ]
    assert len(lines) > 3
    assert [line for line in lines if Named("`", line).command is rossec] == []


@pytest.mark.parametrize(
    ("quoted", "text", "mistake"),
    [
        ("", "ca invite", "missing"),
        ("`", "ca invite", ""),
        ("", "ca invite PATTERN; or by hand", ""),
        ("", f"ca invite {VALUE} --uses", "requires an argument"),
        ("", "ca invite PATTERN --users 3", "no such option"),
        ("`", "ca invite PATTERN --users 3", "no such option"),
        ("", "ca sing FILE", "no verb"),
        ("", "grants", "no verb"),
        ("", "ca", "no verb"),
        ("", "node show NAME NAME", "too many"),
        ("", "topic list shows them", "missing"),
        ("", f"topic list --as {VALUE} shows them", ""),
        ("", "run -- roslaunch FILE", ""),
        ("", "master, and check ROS_MASTER_URI here", ""),
    ],
)
def test_a_mistake_is_found(quoted: str, text: str, mistake: str) -> None:
    found = Named(quoted, text).mistake().lower()
    assert mistake in found
    assert bool(found) == bool(mistake)

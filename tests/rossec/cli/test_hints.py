"""Every command that a hint or a document names exists."""

import re
from collections.abc import Iterator
from pathlib import Path

import click
import pytest

from rossec.cli.main import rossec
from rossec.cli.shared.lazy import LazyCommand

ROOT = Path(__file__).parents[3]


def loaded(command: click.Command) -> click.Command:
    return command.load() if isinstance(command, LazyCommand) else command


NOUNS = {name: loaded(command) for name, command in rossec.commands.items()}


def commands() -> set[str]:
    found = set(NOUNS)
    for noun, command in NOUNS.items():
        if isinstance(command, click.Group):
            found |= {f"{noun} {verb}" for verb in command.commands}
    return found


def named() -> Iterator[tuple[str, str]]:
    sources = [path for name in ("ca", "grants", "rossec") for path in (ROOT / name).rglob("*.py")]
    for path in sources:
        for match in re.finditer(
            r"(?:next: |`|sign one: |see: )rossec ([a-z]+ [a-z0-9-]+|[a-z]+)", path.read_text()
        ):
            yield path.name, match[1]
    for path in (ROOT / "README.md", *ROOT.glob("examples/*.sh")):
        for line in path.read_text().splitlines():
            if line.startswith("rossec "):
                yield path.name, " ".join(line.split()[1:3])


@pytest.mark.parametrize(("where", "command"), sorted(set(named())))
def test_the_named_command_exists(where: str, command: str) -> None:
    known = commands()
    noun = command.split(maxsplit=1)[0]
    assert (
        command in known
        or (noun in known and " " not in command)
        or (noun in known and not isinstance(NOUNS[noun], click.Group))
        or (
            command.startswith((f"{noun} &", f"{noun} --"))
            and getattr(NOUNS[noun], "invoke_without_command", False)
        )
    ), f"{where} names `rossec {command}`"

"""The units of systemd: where they look for rossec, and that their commands can be run."""

import re
import shlex
from pathlib import Path
from typing import Final

import click
import pytest

from rossec.cli.main import rossec
from rossec.cli.shared.context import LazyCommand

ROOT: Final = Path(__file__).parents[3]
UNITS: Final = sorted((ROOT / "examples" / "systemd").glob("*.service"))
PAGE: Final = (ROOT / "docs" / "howto" / "install-for-services.md").read_text()
PROGRAM: Final = "/opt/rossec/bin/rossec"


def test_there_is_one_folder_of_units() -> None:
    assert UNITS
    assert [path for path in ROOT.glob("examples/**/*.service") if path not in UNITS] == []


@pytest.mark.parametrize("unit", UNITS, ids=lambda unit: unit.stem)
def test_a_unit_starts_what_the_page_installs(unit: Path) -> None:
    [line] = re.findall(r"^ExecStart=(.*)$", unit.read_text(), re.MULTILINE)
    program, *words = shlex.split(line)
    assert program == PROGRAM
    assert f"venv --system-site-packages {PROGRAM.removesuffix('/bin/rossec')}\n" in PAGE
    assert f"`{unit.stem}`" in PAGE
    command: click.Command = rossec
    while isinstance(command, click.Group) and words and words[0] in command.commands:
        command = command.commands[words.pop(0)]
        command = command.load() if isinstance(command, LazyCommand) else command
    command.make_context(unit.stem, words, resilient_parsing=False, obj=None).close()


def test_the_units_are_in_the_package() -> None:
    assert '"examples/systemd" = "share/rossec/systemd"' in (ROOT / "pyproject.toml").read_text()
    assert "/opt/rossec/share/rossec/systemd/rossec-master.service" in PAGE


@pytest.mark.parametrize("document", sorted(ROOT.glob("docs/howto/*.md")), ids=lambda d: d.stem)
def test_no_page_installs_a_service_elsewhere(document: Path) -> None:
    for line in re.findall(r"ExecStart=(\S+)", document.read_text()):
        assert line == PROGRAM

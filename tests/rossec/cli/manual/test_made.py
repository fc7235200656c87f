import json
from pathlib import Path

import pytest

from rossec.cli.completion.shells import OutlineTable
from rossec.cli.main import rossec
from rossec.cli.manual import make
from tests.rossec.cli.tables import all_commands


def test_a_build_makes_the_same_twice(tmp_path: Path) -> None:
    first, again = (make(rossec, "1.2", tmp_path / name) for name in ("first", "again"))
    for one, other in zip([*first[0], first[1]], [*again[0], again[1]], strict=True):
        assert one.name == other.name
        assert one.read_bytes() == other.read_bytes()


def test_the_outlines_of_all_commands_are_made(tmp_path: Path) -> None:
    _, table = make(rossec, "1.2", tmp_path)
    found = OutlineTable(table, tmp_path / "no", tmp_path / "no")
    for _, listed, _command in all_commands(rossec):
        if listed is not None:
            made = found.get(listed.place, lambda: pytest.fail("imported"))
            assert made == json.loads(table.read_text())["outlines"][listed.place]
    assert found.get("nouns:ca", lambda: pytest.fail("imported")) == {
        "help": "Run the authority, which signs the identities."
    }

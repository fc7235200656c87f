import json
import os
from pathlib import Path

import click
import pytest

from rossec.cli.completion.shells import OutlineTable
from rossec.cli.completion.values import Outline

OUTLINE: Outline = {"help": "Make it.", "params": [], "interspersed": True, "unknown": False}
LINE: Outline = {"help": "Run it."}


class Imports:
    """Counts how often a command had to be imported."""

    def __init__(self, found: click.Command | None = None) -> None:
        self.count = 0
        self._found = found or click.Command("init", help="Make it. Now.")

    def __call__(self) -> click.Command:
        self.count += 1
        return self._found


@pytest.fixture
def tree(tmp_path: Path) -> Path:
    (tmp_path / "ca").mkdir()
    (tmp_path / "ca" / "init.py").write_text("pass")
    (tmp_path / "main.py").write_text("pass")
    return tmp_path


def table(tree: Path) -> OutlineTable:
    return OutlineTable(tree / "outlines.json", tree / "__pycache__" / "outlines.json", tree)


def test_a_command_is_imported_once(tree: Path) -> None:
    imports = Imports()
    for _ in range(3):
        assert table(tree).get("ca.init:init", imports) == OUTLINE
    assert imports.count == 1
    assert [path.name for path in (tree / "__pycache__").iterdir()] == ["outlines.json"]


def test_a_changed_file_is_imported_again(tree: Path) -> None:
    imports = Imports()
    table(tree).get("ca.init:init", imports)
    (tree / "ca" / "init.py").write_text("pass  # changed")
    table(tree).get("ca.init:init", imports)
    (tree / "ca" / "new.py").write_text("")
    table(tree).get("ca.init:init", imports)
    assert imports.count == 3


def test_of_a_group_its_help_line_is_kept(tree: Path) -> None:
    imports = Imports(click.Group("ca", help="Run it. Now."))
    for _ in range(2):
        assert table(tree).get("nouns:ca", imports) == LINE
    assert imports.count == 1


def test_a_wheel_has_them_all_and_writes_nothing(tree: Path) -> None:
    (tree / "outlines.json").write_text(json.dumps({"outlines": {"ca.init:init": OUTLINE}}))
    imports = Imports(click.Group("ca", help="Run it. Now."))
    assert table(tree).get("ca.init:init", imports) == OUTLINE
    assert imports.count == 0
    assert table(tree).get("nouns:ca", imports) == LINE
    assert not (tree / "__pycache__").exists()


@pytest.mark.parametrize("text", ["", "[]", "{", '{"outlines": 1}', '{"stamp": 1, "outlines": {}}'])
def test_a_damaged_cache_is_made_anew(tree: Path, text: str) -> None:
    (tree / "__pycache__").mkdir()
    (tree / "__pycache__" / "outlines.json").write_text(text)
    imports = Imports()
    for _ in range(2):
        assert table(tree).get("ca.init:init", imports) == OUTLINE
    assert imports.count == 1


def test_where_nothing_can_be_written_completion_goes_on(tree: Path) -> None:
    (tree / "__pycache__").symlink_to(os.devnull)
    imports = Imports()
    assert table(tree).get("ca.init:init", imports) == OUTLINE
    assert table(tree).get("ca.init:init", imports) == OUTLINE
    assert imports.count == 2

import json
import os
from pathlib import Path

import pytest

from rossec.cli.completion.outline import Outline
from rossec.cli.completion.outline_table import OutlineTable

OUTLINE: Outline = {"params": [], "interspersed": True, "unknown": False}


class Imports:
    """Counts how often a command had to be imported."""

    def __init__(self, found: Outline | None = OUTLINE) -> None:
        self.count = 0
        self._found = found

    def __call__(self) -> Outline | None:
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


def test_a_group_is_not_kept(tree: Path) -> None:
    imports = Imports(None)
    assert table(tree).get("ca.group:ca", imports) is None
    assert table(tree).get("ca.group:ca", imports) is None
    assert imports.count == 2


def test_a_wheel_has_them_all_and_writes_nothing(tree: Path) -> None:
    (tree / "outlines.json").write_text(json.dumps({"outlines": {"ca.init:init": OUTLINE}}))
    imports = Imports(None)
    assert table(tree).get("ca.init:init", imports) == OUTLINE
    assert imports.count == 0
    assert table(tree).get("ca.group:ca", imports) is None
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

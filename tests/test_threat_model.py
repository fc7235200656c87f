"""The threat model's table and the marks of the tests in tests/attacks agree, both ways."""

import ast
import re
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
THREATS = (ROOT / "docs" / "threat-model.md").read_text()
TEST = ast.FunctionDef | ast.AsyncFunctionDef
TABLE = THREATS.partition("| attack |")[2].partition("\n\n")[0].splitlines()[2:]


def named_tests(text: str) -> set[str]:
    return set(re.findall(r"`(tests/[^`]*)`", text))


def rows() -> Iterator[tuple[str, set[str]]]:
    for row in TABLE:
        found = re.match(r"\| `([a-z0-9-]+)` \S", row)
        assert found, f"a row begins with the id of its attack: {row}"
        files = named_tests(row.rsplit("|", 2)[1])
        assert files, f"a row names what tests it: {row}"
        yield found[1], {file for file in files if file.startswith("tests/attacks/")}


def attack_ids(*marks: ast.AST) -> list[str]:
    """The arguments of pytest.mark.attack(...) in decorators, or in a module's `pytestmark`."""
    return [
        call.args[0].value
        for mark in marks
        for call in ast.walk(mark)
        if isinstance(call, ast.Call)
        and ast.unparse(call.func) == "pytest.mark.attack"
        and isinstance(call.args[0], ast.Constant)
        and isinstance(call.args[0].value, str)
    ]


def module_marks(module: ast.Module) -> list[ast.AST]:
    return [
        node.value
        for node in module.body
        if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == "pytestmark"
    ]


def played() -> Iterator[tuple[str, str, list[str]]]:
    """Each test of tests/attacks: its file, its name, the ids it carries."""
    for path in sorted(ROOT.glob("tests/attacks/test_*.py")):
        module = ast.parse(path.read_text())
        common = module_marks(module)
        for node in ast.walk(module):
            if isinstance(node, TEST) and node.name.startswith("test_"):
                ids = attack_ids(*common, *node.decorator_list)
                yield str(path.relative_to(ROOT)), node.name, ids


def test_both_sides_are_found() -> None:
    assert len(TABLE) > 50
    assert len(list(played())) > 100


@pytest.mark.parametrize("path", sorted(named_tests(THREATS)))
def test_a_test_that_is_named_exists(path: str) -> None:
    found = ROOT / path
    assert found.is_file() or any(found.glob("test_*.py"))


def test_an_attack_has_one_row() -> None:
    twice = {name: count for name, count in Counter(name for name, _ in rows()).items() if count > 1}
    assert not twice


def test_every_test_of_an_attack_says_which() -> None:
    assert [(file, name) for file, name, ids in played() if not ids] == []


@pytest.mark.parametrize(("attack", "files"), list(rows()), ids=[name for name, _ in rows()])
def test_a_row_names_the_files_that_play_its_attack(attack: str, files: set[str]) -> None:
    assert files == {file for file, _, ids in played() if attack in ids}


def test_every_attack_that_is_played_has_a_row() -> None:
    known = {name for name, _ in rows()}
    assert {name for _, _, ids in played() for name in ids} <= known

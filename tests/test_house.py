"""The house rules: sizes, docstrings, and words that were given up (docs/decisions/0018)."""

import ast
import io
import re
import tokenize
from collections.abc import Iterator
from pathlib import Path
from typing import Final

import pytest

ROOT: Final = Path(__file__).parents[1]
PACKAGES: Final = ("ca", "grants", "rossec")
PRODUCT: Final = sorted(path for package in PACKAGES for path in (ROOT / package).rglob("*.py"))
PROGRAMS: Final = sorted(
    path
    for folder in (*PACKAGES, "tests", "bench", "tools")
    for path in (ROOT / folder).rglob("*.py")
)
LINES: Final = 350
STATEMENT_LINES: Final = 60

RETIRED: Final = {
    "Desk": "ApprovalQueue",
    "Inbox": "GrantRequestStore",
}
"""Identifiers that were given up, and what stands in their place."""

PHRASES: Final = {
    r"gatekeeper": "access control",
}
"""What no text of the product says any more, and what it says instead."""


def named(path: Path) -> str:
    return str(path.relative_to(ROOT))


@pytest.mark.parametrize("path", PROGRAMS, ids=named)
def test_a_file_is_no_longer_than_can_be_read(path: Path) -> None:
    assert len(path.read_text().splitlines()) <= LINES


def functions(path: Path) -> Iterator[tuple[str, int]]:
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            yield node.name, (node.end_lineno or 0) - node.lineno + 1


@pytest.mark.parametrize("path", PROGRAMS, ids=named)
def test_a_function_is_no_longer_than_can_be_read(path: Path) -> None:
    assert [name for name, lines in functions(path) if lines > STATEMENT_LINES] == []


@pytest.mark.parametrize("path", PRODUCT, ids=named)
def test_a_module_begins_with_its_rule(path: Path) -> None:
    text = ast.get_docstring(ast.parse(path.read_text()))
    assert text
    assert len(text.splitlines()) <= 15


@pytest.mark.parametrize("path", PROGRAMS, ids=named)
def test_no_name_is_one_that_was_given_up(path: Path) -> None:
    tokens = tokenize.generate_tokens(io.StringIO(path.read_text()).readline)
    names = {token.string for token in tokens if token.type == tokenize.NAME}
    assert names.isdisjoint(RETIRED), {name: RETIRED[name] for name in names & RETIRED.keys()}


TEXTS: Final = sorted([*PRODUCT, *ROOT.glob("*.md"), *ROOT.glob("docs/**/*.md")])


@pytest.mark.parametrize("path", TEXTS, ids=named)
def test_no_text_has_a_word_that_was_given_up(path: Path) -> None:
    found = [
        (line, instead)
        for line in path.read_text().splitlines()
        for phrase, instead in PHRASES.items()
        if re.search(phrase, line, re.IGNORECASE)
    ]
    assert found == []

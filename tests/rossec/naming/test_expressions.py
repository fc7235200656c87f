"""Functions that expressions call."""

import pytest

from rossec.naming.xslt import ALLOWED, calls, calls_in_template


@pytest.mark.parametrize(
    ("expression", "found"),
    [
        ("a/b", []),
        ("$a = 'document(1)'", []),
        ('concat("document(", a)', [(None, "concat")]),
        ("document('')", [(None, "document")]),
        ("document\n (a)", [(None, "document")]),
        ("a[document (.)]", [(None, "document")]),
        ("child::text()", [(None, "text")]),
        ("str:tokenize(a, ' ')", [("str", "tokenize")]),
        ("str : padding (3)", [("str", "padding")]),
        ("string-length(normalize-space(a))", [(None, "string-length"), (None, "normalize-space")]),
        ("a or (b)", [(None, "or")]),
        ("x-document(a)", [(None, "x-document")]),
        ("'a' | document('b')", [(None, "document")]),
        ("1+document('b')", [(None, "document")]),
        ("concat('it''s', generate-id())", [(None, "concat"), (None, "generate-id")]),
    ],
)
def test_calls_are_found(expression: str, found: list[tuple[str | None, str]]) -> None:
    assert list(calls(expression)) == found


@pytest.mark.parametrize(
    ("text", "found"),
    [
        ("$(find a)", []),
        ("a document(b)", []),
        ("{document(b)}", [(None, "document")]),
        ("'{document(b)}'", [(None, "document")]),
        ("{{ document(b)", [(None, "document")]),  # more than is called, never less
        ("a{'}'}{ext:f()}", [("ext", "f")]),
    ],
)
def test_calls_in_templates_are_found(text: str, found: list[tuple[str | None, str]]) -> None:
    assert list(calls_in_template(text)) == found


def test_nothing_that_reads_or_asks_is_allowed() -> None:
    asks = {"document", "generate-id", "system-property", "unparsed-entity-uri"}
    assert not ALLOWED & (asks | {"element-available", "function-available"})

"""Generated readers: positions, and a restricted namespace."""

import struct

import pytest

from grants.errors import DefinitionRefused
from grants.filters.layout import (
    LAYOUT_ERRORS,
    MAX_LOOPS,
    Array,
    Cursor,
    SourceWriter,
    Text,
    Type,
    expression,
    layout_mismatch,
)
from tests.grants.messages import LAYOUT, layout, text


def end_of(kind: Type, data: bytes) -> object:
    source = SourceWriter("b")
    cursor = Cursor(source)
    cursor.skip(kind)
    source.line(f"return {cursor.at()}")
    return source.compile()(data)


def test_a_position_is_an_expression() -> None:
    assert expression(("", 3), 4) == "7"
    assert expression(("o1", 0)) == "o1"
    assert expression(("o1", 3), 1) == "o1+4"


def test_every_type_can_be_skipped() -> None:
    shape = layout(
        "int8 a\nN[] n\nstring[2] s\nfloat64[] f\nE[] e\nN[0] z", "MSG: t/N\nstring s\nint8 i", "MSG: t/E"
    )
    data = b"a" + struct.pack("<I", 2) + (text("xy") + b"1") * 2 + text("") + text("abc")
    data += struct.pack("<I", 1) + bytes(8) + struct.pack("<I", 2**32 - 1)
    assert end_of(shape.root, data) == len(data)
    for end in range(len(data)):
        try:
            assert end_of(shape.root, data[:end]) != end
        except LAYOUT_ERRORS:
            continue
    assert LAYOUT.root.size is None


def test_loops_end_with_the_message() -> None:
    with pytest.raises(LAYOUT_ERRORS):
        end_of(Array(Text(), None), b"\xff\xff\xff\xff")


def test_loops_are_bounded_in_depth() -> None:
    kind: Type = Text()
    for _ in range(MAX_LOOPS):
        kind = Array(kind, 1)
    assert end_of(kind, text("ab")) == 6
    with pytest.raises(DefinitionRefused, match=f"deeper than {MAX_LOOPS}"):
        end_of(Array(kind, 1), text("ab"))


def test_the_namespace_has_listed_builtins_only() -> None:
    for name in ("__import__", "open", "eval", "getattr", "print"):
        source = SourceWriter("b")
        source.line(f"return {name}")
        with pytest.raises(NameError):
            source.compile()(b"")


def test_bound_values_appear_by_name_only() -> None:
    source = SourceWriter("b")
    name = source.bind("'); import os; ('")
    source.line(f"return {name}")
    assert "import" not in source.text
    assert source.compile()(b"") == "'); import os; ('"


def test_a_layout_mismatch_names_the_type() -> None:
    assert str(layout_mismatch("t/T")) == "a message that is not a t/T: truncated, too long or malformed"

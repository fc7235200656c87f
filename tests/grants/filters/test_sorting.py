"""Sorting: what is left of the elements decides their order, and nothing else."""

import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from grants.errors import FilterRefused, MessageRefused
from grants.filters.compile import compile_filter
from grants.filters.operators import sorting
from grants.model import filter_rules
from tests.grants.messages import layout, text

SHAPE = layout("string a\nS[] x\nuint8 b", "MSG: t/S\nuint8 level\nstring name\nint16[] more")
RULES = filter_rules({"x": {"sort": True}, "x[*].name": {"hash": {"key": "k"}}, "x[*].more": {"clear": True}})
KEYS = {"k": bytes(32)}
Element = tuple[int, str, list[int]]
ELEMENTS = st.lists(
    st.tuples(st.integers(0, 255), st.text(max_size=3), st.lists(st.integers(0, 9), max_size=2)), max_size=30
)


def element(level: int, name: str, more: list[int]) -> bytes:
    numbers = struct.pack(f"<I{len(more)}h", len(more), *more)
    return bytes([level]) + text(name) + numbers


def message(elements: list[Element]) -> bytes:
    inside = b"".join(element(*each) for each in elements)
    return text("a") + len(elements).to_bytes(4, "little") + inside + b"b"


@given(data=st.data(), elements=ELEMENTS)
def test_nothing_of_the_order_remains(data: st.DataObject, elements: list[Element]) -> None:
    compiled = compile_filter(SHAPE, RULES, KEYS)
    other = data.draw(st.permutations(elements))
    assert b"".join(compiled(message(elements))) == b"".join(compiled(message(other)))


def test_elements_are_sorted_as_they_are_sent() -> None:
    """By what the other filters left of them: a name that is hidden has no part in it."""
    rules = filter_rules({"x": {"sort": True}, "x[*].name": {"clear": True}})
    compiled = compile_filter(SHAPE, rules)
    elements: list[Element] = [(7, "a", [2]), (7, "b", [1]), (3, "z", [])]
    assert b"".join(compiled(message(elements))) == message([(3, "", []), (7, "", [1]), (7, "", [2])])


@given(values=st.lists(st.integers(-(2**15), 2**15 - 1)))
def test_elements_of_a_fixed_size(values: list[int]) -> None:
    compiled = compile_filter(layout("int16[] x"), filter_rules({"x": {"sort": True}}))
    packed = [struct.pack("<h", value) for value in values]
    head = len(values).to_bytes(4, "little")
    assert b"".join(compiled(head + b"".join(packed))) == head + b"".join(sorted(packed))


def test_bytes_that_are_no_elements_are_refused() -> None:
    for data in (b"\1", text("a")[:-1]):
        with pytest.raises((ValueError, struct.error)):
            sorting(SHAPE.root.fields[0][1])(data)
    compiled = compile_filter(SHAPE, RULES, KEYS)
    for broken in (message([(1, "a", [])])[:-1], message([]) + b"c"):
        with pytest.raises(MessageRefused):
            compiled(broken)


@pytest.mark.parametrize(
    ("fields", "kind"),
    [("string[3] x", ""), ("string x", ""), ("int8 x", ""), ("E[] x", "MSG: t/E"), ("E x", "MSG: t/E")],
)
def test_what_cannot_be_sorted(fields: str, kind: str) -> None:
    shape = layout(fields, *([kind] if kind else []))
    with pytest.raises(FilterRefused, match="x: sort needs an array of variable length"):
        compile_filter(shape, filter_rules({"x": {"sort": True}}))


def test_two_sorts_inside_each_other_are_refused() -> None:
    shape = layout("E[] x", "MSG: t/E\nint8[] y")
    rules = filter_rules({"x": {"sort": True}, "x[*].y": {"sort": True}})
    with pytest.raises(FilterRefused, match="is inside a field that has a filter"):
        compile_filter(shape, rules)

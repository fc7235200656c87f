"""Rewriting: pieces in order, and a limited number of them."""

import struct
from typing import Any

import pytest

from grants.errors import MessageRefused
from grants.filters.compile import compile_filter
from grants.filters.layout import PRIMITIVES, Array, Struct, Text
from grants.filters.message_rewriter import generate
from grants.filters.operators import (
    ArrayTreatment,
    Constant,
    ContentTreatment,
    FieldTreatment,
    Keep,
    Node,
    Numbers,
    StructTreatment,
)
from grants.model import filter_rules
from tests.grants.messages import layout, text

INT = PRIMITIVES["int32"]
ADD = Numbers(lambda value: value + 1, lambda values: values + 1)
SWAP = Numbers(lambda a, b: (b, a), lambda values: values.reshape(-1, 2)[:, ::-1].reshape(values.shape))
TWICE = ContentTreatment(lambda content: (bytes(content) * 2, len(content) * 2))


def ints(*values: int) -> bytes:
    return struct.pack(f"<{len(values)}i", *values)


def struct_of(*nodes: Node) -> StructTreatment:
    fields = tuple((f"f{n}", node.kind) for n, node in enumerate(nodes))
    return StructTreatment(Struct("t/T", fields), nodes)


def rewrite(node: Node, message: bytes) -> bytes:
    return b"".join(generate(node, "t/T")(message))


def test_adjacent_values_are_one_piece() -> None:
    node = struct_of(
        *[FieldTreatment(INT, ADD)] * 2,
        FieldTreatment(INT, Constant(b"wxyz")),
        Keep(INT),
        FieldTreatment(INT, ADD),
    )
    pieces = generate(node, "t/T")(ints(1, 2, 3, 4, 5))
    assert pieces == [ints(2, 3) + b"wxyz", ints(4), ints(6)]


def test_adjacent_constants_are_one_piece() -> None:
    node = struct_of(FieldTreatment(INT, Constant(b"abcd")), FieldTreatment(INT, Constant(b"efgh")))
    assert generate(node, "t/T")(ints(1, 2)) == [b"abcdefgh"]


def test_a_time_is_treated_as_two_values() -> None:
    pair = PRIMITIVES["duration"]
    assert rewrite(struct_of(FieldTreatment(pair, SWAP), Keep(INT)), ints(1, 2, 3)) == ints(2, 1, 3)
    for length in (2, 20, None):
        kind = Array(pair, length)
        count = b"" if length else (2).to_bytes(4, "little")
        values = [1, 2] * (length or 2)
        expected = count + ints(*values[::-1])
        assert rewrite(ArrayTreatment(kind, FieldTreatment(pair, SWAP)), count + ints(*values)) == expected


def test_content_and_text_are_rewritten() -> None:
    node = struct_of(Keep(Text()), FieldTreatment(Text(), TWICE), FieldTreatment(Text(), Constant(text("-"))))
    assert rewrite(node, text("a") + text("bc") + text("d")) == text("a") + text("bcbc") + text("-")


def test_nested_arrays_are_treated_in_nested_loops() -> None:
    inner = struct_of(Keep(Text()), FieldTreatment(INT, ADD), FieldTreatment(Text(), TWICE), Keep(INT))
    outer = struct_of(Keep(INT), ArrayTreatment(Array(inner.kind, None), inner), FieldTreatment(INT, ADD))
    node = struct_of(Keep(INT), ArrayTreatment(Array(outer.kind, 2), outer), Keep(Text()))

    def message(add: int, times: int) -> bytes:
        item = text("x") + ints(5 + add) + text("ab" * times) + ints(7)
        outer = ints(1) + (2).to_bytes(4, "little") + item * 2 + ints(9 + add)
        return ints(0) + outer * 2 + text("end")

    assert rewrite(node, message(0, 1)) == message(1, 2)


def table(length: int | None) -> ArrayTreatment:
    inside: list[Node] = [Keep(INT), FieldTreatment(INT, ADD), FieldTreatment(INT, Constant(b"wxyz"))]
    numbers = ArrayTreatment(Array(INT, 3), FieldTreatment(INT, ADD))
    element = struct_of(
        *inside, numbers, StructTreatment(Struct("t/S", (("a", INT),)), (FieldTreatment(INT, ADD),))
    )
    return ArrayTreatment(Array(element.kind, length), element)


@pytest.mark.parametrize("count", [0, 1, 5])
def test_arrays_of_fixed_size_elements(count: int) -> None:
    head = count.to_bytes(4, "little")
    before = head + ints(1, 2, 3, 4, 5, 6, 7) * count
    after = head + (ints(1, 3) + b"wxyz" + ints(5, 6, 7, 8)) * count
    assert rewrite(table(None), before) == after
    assert rewrite(table(count or 1), before[4:] or ints(1, 2, 3, 4, 5, 6, 7))
    for end in range(len(before)):
        with pytest.raises(MessageRefused, match="not a t/T"):
            rewrite(table(None), before[:end])


def test_the_source_contains_only_numbers() -> None:
    evil: Any = "x=1\nimport os"
    shape = Struct(evil, ((evil, INT), (evil + "2", Text())))
    node = StructTreatment(shape, (FieldTreatment(INT, ADD), FieldTreatment(Text(), Constant(text(evil)))))
    assert rewrite(node, ints(1) + text("a")) == ints(2) + text(evil)


def test_a_thousand_fields_are_rewritten() -> None:
    fields = "\n".join(f"float64 f{n}" for n in range(1000))
    rules = {f"f{n}": {"round": {"step": 1}} for n in range(0, 1000, 3)}
    message = struct.pack("<1000d", *[n + 0.25 for n in range(1000)])
    out = b"".join(compile_filter(layout(fields), filter_rules(rules))(message))
    expected = [float(n) if n % 3 == 0 else n + 0.25 for n in range(1000)]
    assert struct.unpack("<1000d", out) == tuple(expected)

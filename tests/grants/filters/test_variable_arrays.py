"""Variable arrays: the same bytes as treating the elements one by one."""

import struct

import pytest

from grants.errors import MessageRefused
from grants.filters import message_rewriter
from grants.filters.layout import PRIMITIVES, Array, Struct, Text
from grants.filters.message_rewriter import generate, preserves_sizes
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
from tests.grants.messages import seeded_random, text

INT = PRIMITIVES["int32"]
TIME = PRIMITIVES["time"]
ADD = Numbers(lambda value: value + 1, lambda values: values + 1)
SWAP = Numbers(lambda a, b: (b, a), lambda values: values.reshape(-1, 2)[:, ::-1].reshape(values.shape))


def struct_of(*nodes: Node) -> StructTreatment:
    return StructTreatment(Struct("t/T", tuple((f"f{n}", node.kind) for n, node in enumerate(nodes))), nodes)


def ints(*values: int) -> bytes:
    return struct.pack(f"<{len(values)}i", *values)


FIXED = struct_of(Keep(INT), FieldTreatment(INT, ADD))
INNER = struct_of(Keep(Text()), FieldTreatment(INT, ADD))
# Adjacent regions, separate regions, a fixed array, a nested loop, an empty constant.
ELEMENT = struct_of(
    FieldTreatment(INT, ADD),
    FieldTreatment(TIME, SWAP),
    FieldTreatment(INT, Constant(b"wxyz")),
    Keep(Text()),
    Keep(INT),
    FIXED,
    ArrayTreatment(Array(FIXED.kind, 3), FIXED),
    FieldTreatment(Struct("t/E", ()), Constant(b"")),
    ArrayTreatment(Array(INNER.kind, None), INNER),
    FieldTreatment(INT, ADD),
)


def message(count: int, treated: bool) -> bytes:
    """`count` elements, each of another size."""
    add, rng = int(treated), seeded_random(count)
    parts = [count.to_bytes(4, "little")]
    for n in range(count):
        times = ints(8, 7) if treated else ints(7, 8)
        constant = b"wxyz" if treated else b"abcd"
        parts += [ints(n + add), times, constant, text("x" * rng.randrange(5)), ints(n)]
        parts += [ints(3, n + add) * 4]
        few = rng.randrange(3)
        parts += [few.to_bytes(4, "little")]
        parts += [text("y" * rng.randrange(3)) + ints(5 + add) for _ in range(few)]
        parts += [ints(9 + add)]
    return b"".join(parts) + ints(1)


@pytest.mark.parametrize("count", [0, 1, 5, 23, 24, 25, 300])
def test_a_collected_array_equals_one_by_one(count: int, monkeypatch: pytest.MonkeyPatch) -> None:
    node = struct_of(ArrayTreatment(Array(ELEMENT.kind, None), ELEMENT), Keep(INT))
    assert preserves_sizes(ELEMENT)
    expected = message(count, treated=True)
    assert b"".join(generate(node, "t/T")(message(count, treated=False))) == expected
    for border in (0, 1 << 32):
        monkeypatch.setattr(message_rewriter, "MIN_COLLECTED", border)
        assert b"".join(generate(node, "t/T")(message(count, treated=False))) == expected


def test_a_collected_array_is_one_piece() -> None:
    node = ArrayTreatment(Array(ELEMENT.kind, None), ELEMENT)
    pieces = generate(node, "t/T")(message(30, treated=False)[:-4])
    assert [len(piece) > 0 for piece in pieces] == [True, False]


def test_a_collected_array_of_fixed_length() -> None:
    node = ArrayTreatment(Array(INNER.kind, 40), INNER)
    before, after = ((text("ab") + ints(n)) * 40 for n in (1, 2))
    assert b"".join(generate(node, "t/T")(before)) == after


def test_truncated_and_extended_messages_are_refused() -> None:
    node = ArrayTreatment(Array(ELEMENT.kind, None), ELEMENT)
    generated, whole = generate(node, "t/T"), message(26, treated=False)[:-4]
    for damaged in [*(whole[:end] for end in range(len(whole))), whole + b"\0"]:
        with pytest.raises(MessageRefused, match="not a t/T"):
            generated(damaged)


def test_a_last_value_beyond_the_end_is_refused() -> None:
    """Its position is recorded before the message is known to be too short."""
    kind = struct_of(Keep(Text()), FieldTreatment(INT, ADD))
    short = (24).to_bytes(4, "little") + (text("a") + ints(1)) * 23 + text("a") + b"\0"
    with pytest.raises(MessageRefused, match="not a t/T"):
        generate(ArrayTreatment(Array(kind.kind, None), kind), "t/T")(short)


@pytest.mark.parametrize(
    "node",
    [
        FieldTreatment(Text(), Constant(bytes(4))),
        FieldTreatment(Text(), ContentTreatment(lambda content: (content, len(content)))),
        ArrayTreatment(Array(INT, None), FieldTreatment(INT, ADD)),
        struct_of(Keep(Text()), ArrayTreatment(Array(INT, None), FieldTreatment(INT, ADD))),
    ],
)
def test_treatments_that_change_sizes_are_not_collected(node: Node) -> None:
    assert not preserves_sizes(node)

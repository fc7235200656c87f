"""Gathering: the same bytes as going through the elements one by one."""

import struct

import pytest

from grants.filters import message_rewriter
from grants.filters.codegen import MISFIT
from grants.filters.layout import PRIMITIVES, Array, Struct, Text
from grants.filters.message_rewriter import generate
from grants.filters.treatments import (
    Constant,
    ContentTreatment,
    Each,
    Keep,
    Node,
    Numbers,
    StructTreatment,
    Treated,
)
from grants.filters.variable_arrays import gathers
from tests.grants.messages import chance, text

INT = PRIMITIVES["int32"]
TIME = PRIMITIVES["time"]
ADD = Numbers(lambda value: value + 1, lambda values: values + 1)
SWAP = Numbers(
    lambda a, b: (b, a), lambda values: values.reshape(-1, 2)[:, ::-1].reshape(values.shape)
)


def struct_of(*nodes: Node) -> StructTreatment:
    return StructTreatment(
        Struct("t/T", tuple((f"f{n}", node.kind) for n, node in enumerate(nodes))), nodes
    )


def ints(*values: int) -> bytes:
    return struct.pack(f"<{len(values)}i", *values)


FIXED = struct_of(Keep(INT), Treated(INT, ADD))
INNER = struct_of(Keep(Text()), Treated(INT, ADD))
# Regions that touch, regions apart, a fixed array, a nested loop, an empty constant.
ELEMENT = struct_of(
    Treated(INT, ADD), Treated(TIME, SWAP), Treated(INT, Constant(b"wxyz")), Keep(Text()),
    Keep(INT), FIXED, Each(Array(FIXED.kind, 3), FIXED), Treated(Struct("t/E", ()), Constant(b"")),
    Each(Array(INNER.kind, None), INNER), Treated(INT, ADD),
)  # fmt: skip


def message(count: int, treated: bool) -> bytes:
    """`count` elements, each of another size."""
    add, dice = int(treated), chance(count)
    parts = [count.to_bytes(4, "little")]
    for n in range(count):
        times = ints(8, 7) if treated else ints(7, 8)
        constant = b"wxyz" if treated else b"abcd"
        parts += [ints(n + add), times, constant, text("x" * dice.randrange(5)), ints(n)]
        parts += [ints(3, n + add) * 4]
        few = dice.randrange(3)
        parts += [few.to_bytes(4, "little")]
        parts += [text("y" * dice.randrange(3)) + ints(5 + add) for _ in range(few)]
        parts += [ints(9 + add)]
    return b"".join(parts) + ints(1)


@pytest.mark.parametrize("count", [0, 1, 5, 23, 24, 25, 300])
def test_like_one_by_one(count: int, monkeypatch: pytest.MonkeyPatch) -> None:
    node = struct_of(Each(Array(ELEMENT.kind, None), ELEMENT), Keep(INT))
    assert gathers(ELEMENT)
    expected = message(count, treated=True)
    assert b"".join(generate(node)(message(count, treated=False))) == expected
    for border in (0, 1 << 32):
        monkeypatch.setattr(message_rewriter, "_GATHER", border)
        assert b"".join(generate(node)(message(count, treated=False))) == expected


def test_a_gathered_array_is_one_piece() -> None:
    node = Each(Array(ELEMENT.kind, None), ELEMENT)
    pieces = generate(node)(message(30, treated=False)[:-4])
    assert [len(piece) > 0 for piece in pieces] == [True, False]


def test_fixed_length() -> None:
    node = Each(Array(INNER.kind, 40), INNER)
    before, after = ((text("ab") + ints(n)) * 40 for n in (1, 2))
    assert b"".join(generate(node)(before)) == after


def test_every_prefix_and_a_tail_is_refused() -> None:
    node = Each(Array(ELEMENT.kind, None), ELEMENT)
    generated, whole = generate(node), message(26, treated=False)[:-4]
    for damaged in [*(whole[:end] for end in range(len(whole))), whole + b"\0"]:
        with pytest.raises(MISFIT):
            generated(damaged)


def test_a_last_value_beyond_the_end() -> None:
    """Its place is noted before anything shows that the message is too short."""
    kind = struct_of(Keep(Text()), Treated(INT, ADD))
    short = (24).to_bytes(4, "little") + (text("a") + ints(1)) * 23 + text("a") + b"\0"
    with pytest.raises(MISFIT):
        generate(Each(Array(kind.kind, None), kind))(short)


@pytest.mark.parametrize(
    "node",
    [
        Treated(Text(), Constant(bytes(4))),
        Treated(Text(), ContentTreatment(lambda content: (content, len(content)))),
        Each(Array(INT, None), Treated(INT, ADD)),
        struct_of(Keep(Text()), Each(Array(INT, None), Treated(INT, ADD))),
    ],
)
def test_what_changes_sizes_or_is_an_array_of_its_own_is_not_gathered(node: Node) -> None:
    assert not gathers(node)

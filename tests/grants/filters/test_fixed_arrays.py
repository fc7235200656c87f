"""Arrays of fixed-size elements, treated column by column."""

import numpy as np
import pytest

from grants.filters.coarsening import Vector
from grants.filters.layout import LAYOUT_ERRORS, PRIMITIVES, Array, Struct
from grants.filters.message_rewriter import table_rewriter
from grants.filters.operators import ArrayTreatment, Constant, FieldTreatment, Keep, Numbers, StructTreatment

BYTE = PRIMITIVES["uint8"]
CALLS: list[tuple[int, ...]] = []


def add(values: Vector) -> Vector:
    CALLS.append(values.shape)
    return values + 1


ADD = Numbers(lambda value: value + 1, add)
INNER = Struct("t/I", (("a", BYTE), ("b", BYTE)))
ELEMENT = Struct("t/E", (("k", BYTE), ("x", BYTE), ("y", BYTE), ("i", Array(INNER, 2)), ("z", BYTE)))
TREATED = FieldTreatment(BYTE, ADD)
NODE = StructTreatment(
    ELEMENT,
    (
        Keep(BYTE),
        TREATED,
        TREATED,
        ArrayTreatment(Array(INNER, 2), StructTreatment(INNER, (TREATED, Keep(BYTE)))),
        FieldTreatment(BYTE, Constant(b"z")),
    ),
)


def test_adjacent_columns_are_merged() -> None:
    CALLS.clear()
    rewrite = table_rewriter(NODE, 8)
    message = b"??" + bytes([0, 1, 2, 3, 4, 5, 6, 7]) * 3 + b"?"
    assert rewrite(message, 2, 3) == bytes([0, 2, 3, 4, 4, 6, 6, ord("z")]) * 3
    assert CALLS == [(3, 3), (3, 1)]  # x, y and the first a in one; the second a


def test_a_count_beyond_the_message_is_refused() -> None:
    rewrite = table_rewriter(NODE, 8)
    assert rewrite(b"", 0, 0) == b""
    for count in (1, 2**32):
        with pytest.raises(LAYOUT_ERRORS):
            rewrite(bytes(7), 0, count)


def test_the_message_is_not_changed() -> None:
    message = bytearray(8)
    table_rewriter(NODE, 8)(memoryview(message), 0, 1)
    assert message == bytes(8)
    assert np.frombuffer(message, np.uint8).sum() == 0

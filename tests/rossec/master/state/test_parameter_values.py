"""Which values are valid parameters, and their approximate size."""

from datetime import datetime
from decimal import Decimal
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rossec.master.state.parameters import DEPTH_LIMIT, check_value, encoded_size, exceeds
from rossec.ros import xmlrpc
from rossec.ros.xmlrpc import EncodedList

_WHEN = datetime(2020, 1, 2, 3, 4, 5)  # noqa: DTZ001 - XML-RPC's times have no zone
_GOOD = st.recursive(
    st.booleans()
    | st.integers(-(2**31), 2**31 - 1)
    | st.floats()
    | st.text("a<&\u20ac ")
    | st.binary(max_size=9)
    | st.just(_WHEN),
    lambda below: st.lists(below, max_size=3) | st.dictionaries(st.text("ab", min_size=1), below),
    max_leaves=9,
)


@given(_GOOD, st.integers(0, 300))
def test_exceeds_stops_early(value: Any, limit: int) -> None:
    assert exceeds(value, limit) == (encoded_size(value) > limit)
    assert exceeds({"much": "x" * limit, "never looked at": object()}, limit)


@given(_GOOD)
def test_accepted_values_can_be_encoded(value: Any) -> None:
    check_value(value)
    size = len(xmlrpc.dump_response(value)) - len(xmlrpc.dump_response([])) + encoded_size([])
    assert size < 2 * encoded_size(value) + 100
    assert encoded_size(value) < 2 * size + 100


@pytest.mark.parametrize(
    ("value", "message"),
    [
        (2**31, "the number 2147483648"),
        (-(2**31) - 1, "the number -2147483649"),
        pytest.param(10**5000, "a number this long", id="str() refuses it"),
        (None, "nil"),
        (Decimal("1.5"), "a Decimal"),
    ],
)
def test_values_that_cannot_be_encoded_are_refused_at_any_depth(value: object, message: str) -> None:
    for spoilt in (value, [1, value], {"a": {"b": [value]}}):
        with pytest.raises(ValueError, match=f"XML-RPC cannot carry {message}"):
            check_value(spoilt)


@pytest.mark.parametrize("name", ["a/b", "", "~a"])
def test_names_in_a_tree_are_one_segment(name: str) -> None:
    with pytest.raises(ValueError, match="cannot be the name"):
        check_value({"a": {name: 1}})


def test_the_depth_is_bounded() -> None:
    value: object = 1
    for _ in range(DEPTH_LIMIT):
        value = [value]
    check_value(value)
    with pytest.raises(ValueError, match=f"deeper than {DEPTH_LIMIT}"):
        check_value([value])
    with pytest.raises(ValueError, match="deeper"):
        check_value(1, -1)


def test_the_size_of_encoded_text_is_its_length() -> None:
    state = EncodedList([["/t", ["/node"]]])
    assert encoded_size([1, "", state]) - encoded_size([1, ""]) == len(state.text)
    assert encoded_size((1, 2)) == encoded_size([1, 2])


def test_a_number_is_not_a_valid_name() -> None:
    """XML-RPC's structs can have a number as a member's name."""
    with pytest.raises(ValueError, match="1 cannot be the name of a parameter"):
        check_value({1: 2})

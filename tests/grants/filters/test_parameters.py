"""Parameters: exactly the expected ones, of their type and in their range."""

import math
from typing import Any

import pytest

from grants.errors import FilterRefused
from grants.filters.operators import expect, integer, number


def test_exactly_the_expected_names() -> None:
    expect({})
    expect({"a": 1, "b": 2}, "b", "a")
    with pytest.raises(FilterRefused, match="expected a, b, found none"):
        expect({}, "a", "b")
    with pytest.raises(FilterRefused, match="expected no parameters, found a, b"):
        expect({"b": 1, "a": 1})


@pytest.mark.parametrize("value", [None, True, "1", math.nan, 1 << 64, -(1 << 64)])
def test_what_is_no_number(value: Any) -> None:
    with pytest.raises(FilterRefused, match="x"):
        number({"x": value} if value is not None else {}, "x")


def test_numbers_as_they_are() -> None:
    assert [number({"x": value}, "x") for value in (1, 0.5, -math.inf)] == [1, 0.5, -math.inf]


@pytest.mark.parametrize("value", [None, True, "1", 1.0, 0, 10])
def test_what_is_no_whole_number_in_the_range(value: Any) -> None:
    with pytest.raises(FilterRefused, match="x must be a whole number from 1 to 9"):
        integer({"x": value} if value is not None else {}, "x", 9)
    assert integer({"x": 9}, "x", 9) == 9
    assert integer({"x": -2}, "x", 9, minimum=-2) == -2

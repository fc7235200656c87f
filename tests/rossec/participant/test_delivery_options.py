"""DeliveryOptions in connection headers: read strictly, and answered with no more than was asked."""

import math
from types import SimpleNamespace
from typing import Any

import pytest

from grants.model import Restriction, filter_rules
from rossec.errors import ConfigurationError, ConnectionHeaderRefused
from rossec.participant.delivery_options import (
    NO_OPTIONS,
    DeliveryOptions,
    accepted_options,
    carried_out,
    requested_options,
    without_options,
)
from rossec.ros import tcpros

ALL = DeliveryOptions(2.5, newest=True, deflate=True)
FIELDS = {"rossec_rate": b"2.500", "rossec_newest": b"1", "rossec_deflate": b"1"}


def test_a_header_says_them_and_is_read_back() -> None:
    assert ALL.fields == FIELDS
    assert requested_options(tcpros.decode(tcpros.encode(ALL.fields)[4:])) == ALL
    for options in (
        DeliveryOptions(0.001),
        DeliveryOptions(10_000),
        DeliveryOptions(newest=True),
        DeliveryOptions(deflate=True),
    ):
        assert requested_options({"topic": b"/t", **options.fields}) == options
        assert bool(options)


def test_without_options_nothing_is_said() -> None:
    assert NO_OPTIONS.fields == {}
    assert not NO_OPTIONS
    assert requested_options({"topic": b"/t"}) is NO_OPTIONS
    assert without_options({"topic": b"/t", **FIELDS}) == {"topic": b"/t"}


def test_a_rate_has_three_decimals() -> None:
    assert DeliveryOptions(1 / 3).rate == 0.333
    assert DeliveryOptions(30).fields == {"rossec_rate": b"30.000"}


@pytest.mark.parametrize("rate", [0, -1, 0.0009, 10_001, math.nan, math.inf, -math.inf])
def test_an_absurd_rate_cannot_be_wished(rate: float) -> None:
    with pytest.raises(ConfigurationError, match="a rate of") as caught:
        DeliveryOptions(rate)
    assert "from 0.001 to 10000" in caught.value.hint


@pytest.mark.parametrize(
    "value",
    [
        b"",
        b"0",
        b"0.000",
        b"-1",
        b"+1",
        b"1e3",
        b"nan",
        b"inf",
        b"1_0",
        b" 1",
        b"1 ",
        b"1\n",
        b"1,5",
        b".5",
        b"1.",
        b"0.0001",
        b"10000.001",
        b"99999",
        b"9" * 48_000,
        b"1\0",
        b"0x1",
        "\uff11".encode(),
        b"\xff",
    ],
    ids=repr,
)
def test_a_rate_that_is_none_is_refused(value: bytes) -> None:
    with pytest.raises(ConnectionHeaderRefused, match="'rossec_rate' is no rate"):
        requested_options({"rossec_rate": value})


@pytest.mark.parametrize("key", ["rossec_newest", "rossec_deflate"])
@pytest.mark.parametrize("value", [b"", b"0", b"true", b"01", b"1\n", b"2"])
def test_another_value_than_1_is_refused(key: str, value: bytes) -> None:
    with pytest.raises(ConnectionHeaderRefused, match=f"{key!r} is not 1"):
        requested_options({key: value})


def test_a_publisher_may_take_some_of_them() -> None:
    assert accepted_options({}, ALL) == NO_OPTIONS
    assert accepted_options(FIELDS, ALL) == ALL
    assert accepted_options({"rossec_newest": b"1"}, ALL) == DeliveryOptions(newest=True)
    assert accepted_options({"rossec_rate": b"2.5"}, ALL) == DeliveryOptions(2.5)


@pytest.mark.parametrize(
    ("restriction", "deflates"),
    [
        (Restriction(rate=1.0), True),
        (Restriction(keep_when_stale=True), True),
        (Restriction(conditions=("hour < 5",)), False),
        (Restriction(slot=60), False),
        (Restriction("std_msgs/String", (), filter_rules({"data": {"clear": True}})), False),
    ],
)
def test_what_is_filtered_or_withheld_is_not_deflated(restriction: Restriction, deflates: bool) -> None:
    decision: Any = SimpleNamespace(restrictions=(Restriction(rate=2.0), restriction))
    assert carried_out(ALL, decision) == DeliveryOptions(2.5, newest=True, deflate=deflates)
    assert carried_out(ALL, SimpleNamespace(restrictions=())) == ALL  # type: ignore[arg-type]


@pytest.mark.parametrize("asked", [NO_OPTIONS, DeliveryOptions(7)])
@pytest.mark.parametrize("key", FIELDS)
def test_a_publisher_may_take_none_that_was_not_asked(asked: DeliveryOptions, key: str) -> None:
    with pytest.raises(ConnectionHeaderRefused, match="asked"):
        accepted_options({key: FIELDS[key]}, asked)

"""Fields of a time in time zones, numbered as in CEL."""

import pytest

from grants.conditions.compile import FIELDS, clock_field, parse_timestamp
from grants.errors import ConditionRefused

EXPECTED = {
    "getFullYear": 2027,
    "getMonth": 2,
    "getDate": 7,
    "getDayOfMonth": 6,
    "getDayOfWeek": 0,
    "getDayOfYear": 65,
    "getHours": 23,
    "getMinutes": 59,
    "getSeconds": 59,
}


def test_all_fields_have_their_value() -> None:
    moment = parse_timestamp("2027-03-07T23:59:59+01:00")
    found = {name: clock_field(name, "Europe/Zurich")(moment) for name in FIELDS}
    assert found == EXPECTED


def test_daylight_saving_time_is_applied() -> None:
    hours = clock_field("getHours", "Europe/Zurich")
    change = parse_timestamp("2027-03-28T01:00:00Z")
    assert [hours(change - 1), hours(change)] == [1, 3]


def test_timestamps_are_parsed() -> None:
    assert parse_timestamp("1970-01-01T00:00:00Z") == 0
    assert parse_timestamp("2027-01-15T08:00:00Z") == 1_800_000_000


@pytest.mark.parametrize(
    "text",
    [
        "",
        "now",
        "2027-01-15",
        "2027-01-15T08:00:00",
        "2027-02-30T00:00:00Z",
        "2027-01-15T08:00:00.5Z",
        "2027-01-15 08:00:00Z",
        "2027-01-15T08:00:00+99:00",
    ],
)
def test_invalid_timestamps_are_refused(text: str) -> None:
    with pytest.raises(ConditionRefused, match="not a time"):
        parse_timestamp(text)


@pytest.mark.parametrize("zone", ["", "Mars", "../UTC", "/etc/passwd", "Europe", "UTC\0", "Zürich"])
def test_unknown_zones_are_refused(zone: str) -> None:
    with pytest.raises(ConditionRefused, match="unknown time zone"):
        clock_field("getHours", zone)

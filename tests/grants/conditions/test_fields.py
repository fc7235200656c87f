"""Which fields a condition reads."""

import pytest

from grants.conditions.syntax import fields_read, reads


@pytest.mark.parametrize(
    ("text", "fields"),
    [
        ("now.getHours() >= 8", []),
        ("msg.a.x < 5 && (msg.b == 1 || msg.a.x > -3)", ["a.x", "b"]),
        ('msg.name in ["a", msg.other] && !msg.open', ["name", "other", "open"]),
        ('msg.header.frame_id.startsWith("map")', ["header.frame_id"]),
        ("-msg.a + 2 * msg.b < msg.c", ["a", "b", "c"]),
    ],
)
def test_every_field_that_is_named_is_read_once(text: str, fields: list[str]) -> None:
    assert fields_read(text) == fields


@pytest.mark.parametrize(
    ("field", "read"), [("a.x", True), ("a.y", False), ("a.x.part", True), ("a", True), ("aa.x", False)]
)
def test_a_part_and_the_whole_of_what_is_read_are_read(field: str, read: bool) -> None:
    assert reads("msg.a.x < 5", field) is read


def test_a_field_of_elements_is_read_with_its_array() -> None:
    assert reads("msg.poses < 5", "poses[*].x")


def test_what_is_no_condition_is_taken_to_read_everything() -> None:
    assert reads("msg.a <", "anything")

"""What a topic looks like to each of its receivers."""

import math

import numpy as np
import pytest

from grants.model import Restriction, filter_rules
from rossec.console import samples
from rossec.console.matrix import Cell, TopicAccess
from rossec.console.pictures import looks
from rossec.console.pictures import looks as image
from rossec.console.pictures import looks as laser
from rossec.console.pictures.looks import Comparison
from rossec.console.samples import Recorded
from rossec.errors import MessageError
from rossec.participant.message_types import message_type
from tests.support.consolehome import COARSE, HOSTILE, POSE
from tests.support.drawings import checked

FIX = "sensor_msgs/NavSatFix"


def compare(kind: str, *ways: Restriction | None) -> Comparison:
    recorded = samples.recorded("/robot/topic", kind)
    assert recorded is not None
    cells = [
        Cell(
            f"/node_{at}",
            "/robot/topic",
            TopicAccess.COARSE if way else TopicAccess.ALL,
            "said",
            "",
            (b"g",),
            (way,) if way else (),
        )
        for at, way in enumerate(ways)
    ]
    return looks.compare(recorded, cells)


def test_one_drive_exact_and_coarse() -> None:
    found = compare(POSE, COARSE, None)
    assert found.is_made_up
    exact, coarse = found.looks
    assert (exact.receivers, exact.heading) == (("/node_1",), "sees the exact place")
    assert exact.caption == "240 places in this minute: said"
    assert (coarse.receivers, coarse.heading) == (("/node_0",), "sees which square")
    assert coarse.caption.startswith("12 squares in this minute")
    for look in found.looks:
        checked(look.picture)


def test_receivers_that_see_the_same_share_a_look() -> None:
    found = compare(POSE, COARSE, None, None)
    assert [each.receivers for each in found.looks] == [("/node_1", "/node_2"), ("/node_0",)]


def test_who_sees_nothing_has_no_look() -> None:
    recorded = samples.recorded("/robot/topic", POSE)
    assert recorded is not None
    assert looks.compare(recorded, [Cell("/a", "/t", TopicAccess.ENDED)]).looks == ()


def test_a_place_that_was_removed_is_said_and_the_fields_are_shown() -> None:
    gone = Restriction(POSE, (), filter_rules({"pose.position": {"clear": True}}))
    (look,) = compare(POSE, gone).looks
    assert look.heading == "does not see the place"
    assert look.picture is None
    struck = {line.path for line in look.fields if line.removed}
    assert struck == {f"pose.position.{axis}" for axis in "xyz"}
    assert all(line.value == "" for line in look.fields if line.removed)


def test_a_laser_a_picture_and_a_number() -> None:
    (seen,) = compare(laser.SCAN_TYPE, None).looks
    assert seen.heading == "sees what the laser meets"
    checked(seen.picture)
    blur = Restriction(image.IMAGE_TYPE, (), filter_rules({"data": {"pixelate": {"block": 32}}}))
    assert [each.heading for each in compare(image.IMAGE_TYPE, blur, None).looks] == [
        "sees the picture",
        "sees this of the picture",
    ]
    (number,) = compare("sensor_msgs/BatteryState", None).looks
    assert number.heading == "sees the voltage"
    checked(number.picture)


def test_another_type_is_shown_as_fields() -> None:
    hidden = Restriction("std_msgs/String", (), filter_rules({"data": {"redact": {"text": "-"}}}))
    exact, coarse = compare("std_msgs/String", hidden, None).looks
    assert exact.heading == "sees these fields"
    assert [(line.path, line.value) for line in exact.fields] == [("data", "some data")]
    assert [(line.path, line.value) for line in coarse.fields] == [("data", "-")]


def test_a_rate_shows_in_the_number_of_messages() -> None:
    (look,) = compare(POSE, Restriction(POSE, (), (), 0.2)).looks
    assert "in this minute" in look.caption
    assert int(look.caption.split()[0]) <= 15


def test_a_grant_for_another_type_gets_nothing() -> None:
    (look,) = compare("std_msgs/String", COARSE).looks
    assert look.heading.startswith("gets nothing")


def test_messages_of_an_unknown_type_have_no_look() -> None:
    recorded = Recorded("/t", "my_msgs/Own", ((0.0, b"x"),))
    assert looks.compare(recorded, [Cell("/a", "/t", TopicAccess.ALL)]).looks == ()


def test_messages_that_never_pass_are_said() -> None:
    recorded = samples.recorded("/t", POSE)
    assert recorded is not None
    never = Restriction(POSE, ('msg.header.frame_id == "elsewhere"',))
    cell = Cell("/a", "/t", TopicAccess.COARSE, "only when", "", (b"g",), (never,))
    (look,) = looks.compare(recorded._replace(is_made_up=False), [cell]).looks
    assert look.heading == "gets none of these"
    assert look.caption == "none of 240 messages passed: only when"


def test_only_so_many_ways_are_drawn() -> None:
    ways = [Restriction(POSE, (), (), rate) for rate in range(1, 10)]
    found = compare(POSE, *ways)
    assert (len(found.looks), found.more) == (looks.MAX_LOOKS, 3)


def test_a_hostile_text_in_a_message_is_text() -> None:
    hidden = Restriction("std_msgs/String", (), filter_rules({"data": {"redact": {"text": HOSTILE}}}))
    (look,) = compare("std_msgs/String", hidden).looks
    assert "\u202e" not in look.fields[0].value
    assert len(look.fields[0].value) < 80


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, 1.7e308, -1.7e308, 5e-324])
@pytest.mark.parametrize("kind", sorted([POSE, FIX, laser.SCAN_TYPE, "sensor_msgs/BatteryState"]))
def test_strange_numbers_of_a_robot_are_drawn_or_left_out(kind: str, value: float) -> None:
    made = message_type(kind)

    def message(at: int) -> bytes:
        found = made.create()
        if kind == POSE:
            found.pose.position.x, found.pose.position.y = value, float(at)
            found.pose.orientation.z, found.pose.orientation.w = value, value
        elif kind == FIX:
            found.latitude, found.longitude = value, float(at)
        elif kind == laser.SCAN_TYPE:
            found.angle_min, found.ranges = value, np.ones(9, np.float32)
        else:
            found.voltage = value if at % 2 else -value
        return bytes(made.serialize(found))

    try:
        messages = tuple((float(at), message(at)) for at in range(4))
    except MessageError:  # float32 has no such number
        return
    recorded = Recorded("/t", kind, messages)
    (look,) = looks.compare(recorded, [Cell("/a", "/t", TopicAccess.ALL)]).looks
    if look.picture is not None:
        checked(look.picture)

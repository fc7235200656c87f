"""The report to print."""

from grants.policy.privacy import ReceiverAccess
from rossec.console.matrix import topics
from rossec.console.pages.visibility import write
from rossec.participant.host_types import layout_of
from tests.support.consolehome import HOSTILE, NOW, POSE, as_service, crowd, demo
from tests.support.consolepages import Browser


def test_every_field_of_what_is_granted() -> None:
    made = Browser(as_service(demo()))
    made.now = NOW
    text = made.log_in().get("/privacy").text
    for said in ("/robot/pose", "pose.orientation.w", "removed", "as it is", "position to 2 m"):
        assert said in text
    assert "/robot/camera" not in text


def test_a_crowd_is_printed_part_by_part() -> None:
    made = Browser(as_service(crowd()))
    made.now = NOW
    assert "topics 13 to 24 of 40" in made.log_in().get("/privacy?row=12").text


def test_the_file_needs_nothing_beside_it_and_escapes_every_text() -> None:
    access = ReceiverAccess("/a", POSE, "/x", HOSTILE, HOSTILE, HOSTILE)
    text = write(topics([access], layout_of), HOSTILE, NOW)
    assert "<script" not in text
    assert "\u202e" not in text
    assert "pose.position.x" in text
    assert "http" not in text
    assert "src=" not in text
    assert "@media print" in text
    assert "No receiver has access" in write([], "robbie", NOW)

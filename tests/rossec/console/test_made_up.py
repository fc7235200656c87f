"""A minute that nobody drove."""

import pytest

from grants.filters.compile import PRESETS
from rossec.console import samples
from rossec.console.pictures.looks import MAX_MESSAGES
from rossec.console.samples import see
from rossec.participant.host_types import layout_of
from rossec.participant.message_types import type_names


@pytest.fixture(autouse=True)
def _made_anew() -> None:
    samples.messages.cache_clear()


def test_it_is_always_the_same() -> None:
    one = samples.recorded("/a", "geometry_msgs/PoseStamped")
    assert one == samples.recorded("/a", "geometry_msgs/PoseStamped")
    assert one is not None
    assert one.is_made_up
    assert len(one.messages) == 240
    assert one.messages[-1][0] < 60


def test_an_unknown_type_has_none() -> None:
    assert samples.recorded("/a", "some_msgs/Unknown") is None


@pytest.mark.parametrize("kind", sorted(type_names()))
def test_every_known_type_can_be_made_up(kind: str) -> None:
    found = samples.recorded("/a", kind)
    assert found is not None
    seen = see(found._replace(messages=found.messages[:2]), "/b", [])
    assert len(seen.samples) == 2


def test_where_one_receiver_has_slots_it_takes_ten_minutes() -> None:
    """Of a minute, one in slots of 30 s gets one message or none: a picture would say nothing."""
    slots = PRESETS["coarse-position"].restriction(layout_of("geometry_msgs/PoseStamped"))
    short = samples.recorded("/pose", "geometry_msgs/PoseStamped")
    found = samples.recorded("/pose", "geometry_msgs/PoseStamped", [slots])
    assert short is not None
    assert found is not None
    assert (short.messages[-1][0], found.messages[-1][0]) == (59.75, 599.0)
    assert len(found.messages) <= MAX_MESSAGES, "all of it is drawn"
    seen = see(found, "/lamp", [slots])
    places = {
        (each.fields["pose"]["position"]["x"], each.fields["pose"]["position"]["y"]) for each in seen.samples
    }
    assert len(seen.samples) >= 15
    assert len(places) > 2

"""A minute that nobody drove."""

import pytest

from rossec.console import made_up
from rossec.console.samples import see
from rossec.participant.message_types import type_names


@pytest.fixture(autouse=True)
def _made_anew() -> None:
    made_up.messages.cache_clear()


def test_it_is_always_the_same() -> None:
    one = made_up.recorded("/a", "geometry_msgs/PoseStamped")
    assert one == made_up.recorded("/a", "geometry_msgs/PoseStamped")
    assert one is not None
    assert one.is_made_up
    assert len(one.messages) == 240
    assert one.messages[-1][0] < 60


def test_an_unknown_type_has_none() -> None:
    assert made_up.recorded("/a", "some_msgs/Unknown") is None


@pytest.mark.parametrize("kind", sorted(type_names()))
def test_every_known_type_can_be_made_up(kind: str) -> None:
    found = made_up.recorded("/a", kind)
    assert found is not None
    seen = see(found._replace(messages=found.messages[:2]), "/b", [])
    assert len(seen.samples) == 2

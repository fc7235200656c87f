from dataclasses import dataclass

import pytest

from rossec.channel.opening import WireProtocol
from rossec.errors import ConfigurationError
from rossec.sidecar.core.endpoints import Endpoint, inside
from rossec.sidecar.port_pool import PortPool


@dataclass
class Door:
    connections: int = 0


PLACES = [inside(WireProtocol.HTTP, port) for port in range(1, 6)]


def test_the_idle_one_that_was_asked_for_longest_ago_makes_room() -> None:
    closed: list[Endpoint] = []
    doors = PortPool[Door](lambda place, _: closed.append(place), limit=3)
    first, second, _ = (doors.ask(place, Door) for place in PLACES[:3])
    assert doors.ask(PLACES[0], Door) is first
    second.connections = 1
    fourth = doors.ask(PLACES[3], Door)
    assert closed == [PLACES[2]]
    assert doors.get(PLACES[2]) is None
    assert list(doors) == [second, first, fourth]


def test_only_what_can_be_spared_makes_room() -> None:
    """A live program that nobody calls keeps its door: its address is known to the master."""
    closed: list[Endpoint] = []
    dead = {PLACES[1]}
    doors = PortPool[Door](lambda place, _: closed.append(place), dead.__contains__, limit=3)
    for place in PLACES[:4]:
        doors.ask(place, Door)
    assert closed == PLACES[1:2]
    with pytest.raises(ConfigurationError):
        doors.ask(PLACES[4], Door)


def test_doors_in_use_stay() -> None:
    doors = PortPool[Door](lambda *_: pytest.fail("closed one in use"), limit=2)
    for place in PLACES[:2]:
        doors.ask(place, lambda: Door(1))
    with pytest.raises(ConfigurationError, match="more than 2 addresses") as caught:
        doors.ask(PLACES[2], Door)
    assert "identity" in caught.value.hint

import pytest

from rossec.channel.opening import Flavour
from rossec.sidecar.core.endpoints import Doors, Endpoint, endpoint, inside

SLAVE = inside(Flavour.HTTP, 5000)
PEER = Endpoint(Flavour.TCPROS, "10.0.0.7", 6000)


@pytest.mark.parametrize(
    ("uri", "flavour", "found"),
    [
        ("http://10.0.0.7:6000/", Flavour.HTTP, Endpoint(Flavour.HTTP, "10.0.0.7", 6000)),
        ("rosrpc://[fd99::2]:6000", Flavour.TCPROS, Endpoint(Flavour.TCPROS, "fd99::2", 6000)),
        ("rosrpc://10.0.0.7:6000", Flavour.HTTP, None),
        ("http://10.0.0.7/", Flavour.HTTP, None),
        ("http://:6000/", Flavour.HTTP, None),
        ("", Flavour.HTTP, None),
        (7, Flavour.HTTP, None),
    ],
)
def test_uris(uri: object, flavour: Flavour, found: Endpoint | None) -> None:
    assert endpoint(uri, flavour) == found


def test_endpoints_are_written_as_in_ros() -> None:
    assert SLAVE.uri == "http://127.0.0.1:5000/"
    assert Endpoint(Flavour.TCPROS, "fd99::2", 6000).uri == "rosrpc://[fd99::2]:6000"


def test_doors_lead_both_ways() -> None:
    doors = Doors("robot.local")
    outside = doors.opened_outside(SLAVE, 7000)
    assert outside.uri == "http://robot.local:7000/"
    assert doors.program_behind(outside) == SLAVE
    assert doors.program_behind(PEER) is None
    door = doors.opened_inside(PEER, 8000)
    assert door == inside(Flavour.TCPROS, 8000)
    assert doors.peer_behind(door) == PEER
    assert doors.peer_behind(inside(Flavour.HTTP, 8000)) is None
    assert doors.peer_behind(SLAVE) is None
    doors.closed_outside(SLAVE, 7000)
    doors.closed_inside(8000)
    assert doors.program_behind(outside) is None
    assert doors.peer_behind(door) is None


def test_a_program_gets_its_uri_back_as_it_wrote_it() -> None:
    doors = Doors("robot.local")
    assert doors.spelling(SLAVE) == SLAVE.uri
    doors.spell(SLAVE, "http://localhost:5000")
    assert doors.spelling(SLAVE) == "http://localhost:5000"


def test_programs_are_told_loopback_by_the_name_they_reach_it_by() -> None:
    doors = Doors("fd99::1", "localhost")
    assert doors.opened_inside(PEER, 8000).uri == "rosrpc://localhost:8000"
    assert doors.peer_behind(inside(Flavour.TCPROS, 8000)) == PEER
    assert doors.spelling(SLAVE) == "http://localhost:5000/"

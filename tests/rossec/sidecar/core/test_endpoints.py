import pytest

from rossec.channel.opening import WireProtocol
from rossec.sidecar.core.endpoints import Endpoint, EndpointMap, endpoint, inside

SLAVE = inside(WireProtocol.HTTP, 5000)
PEER = Endpoint(WireProtocol.TCPROS, "10.0.0.7", 6000)


@pytest.mark.parametrize(
    ("uri", "flavour", "found"),
    [
        ("http://10.0.0.7:6000/", WireProtocol.HTTP, Endpoint(WireProtocol.HTTP, "10.0.0.7", 6000)),
        (
            "rosrpc://[fd99::2]:6000",
            WireProtocol.TCPROS,
            Endpoint(WireProtocol.TCPROS, "fd99::2", 6000),
        ),
        ("rosrpc://10.0.0.7:6000", WireProtocol.HTTP, None),
        ("http://10.0.0.7/", WireProtocol.HTTP, None),
        ("http://:6000/", WireProtocol.HTTP, None),
        ("", WireProtocol.HTTP, None),
        (7, WireProtocol.HTTP, None),
    ],
)
def test_uris(uri: object, flavour: WireProtocol, found: Endpoint | None) -> None:
    assert endpoint(uri, flavour) == found


def test_endpoints_are_written_as_in_ros() -> None:
    assert SLAVE.uri == "http://127.0.0.1:5000/"
    assert Endpoint(WireProtocol.TCPROS, "fd99::2", 6000).uri == "rosrpc://[fd99::2]:6000"


def test_doors_lead_both_ways() -> None:
    doors = EndpointMap("robot.local")
    outside = doors.opened_outside(SLAVE, 7000)
    assert outside.uri == "http://robot.local:7000/"
    assert doors.program_behind(outside) == SLAVE
    assert doors.program_behind(PEER) is None
    door = doors.opened_inside(PEER, 8000)
    assert door == inside(WireProtocol.TCPROS, 8000)
    assert doors.peer_behind(door) == PEER
    assert doors.peer_behind(inside(WireProtocol.HTTP, 8000)) is None
    assert doors.peer_behind(SLAVE) is None
    doors.closed_outside(SLAVE, 7000)
    doors.closed_inside(8000)
    assert doors.program_behind(outside) is None
    assert doors.peer_behind(door) is None


def test_a_program_gets_its_uri_back_as_it_wrote_it() -> None:
    doors = EndpointMap("robot.local")
    assert doors.spelling(SLAVE) == SLAVE.uri
    doors.spell(SLAVE, "http://localhost:5000")
    assert doors.spelling(SLAVE) == "http://localhost:5000"


def test_programs_are_told_loopback_by_the_name_they_reach_it_by() -> None:
    doors = EndpointMap("fd99::1", "localhost")
    assert doors.opened_inside(PEER, 8000).uri == "rosrpc://localhost:8000"
    assert doors.peer_behind(inside(WireProtocol.TCPROS, 8000)) == PEER
    assert doors.spelling(SLAVE) == "http://localhost:5000/"

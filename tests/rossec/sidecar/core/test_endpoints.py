import pytest

from rossec.channel.opening import WireProtocol
from rossec.sidecar.core.layers import EndpointMap, ListeningAddress, local_endpoint, parse_endpoint

SLAVE = local_endpoint(WireProtocol.HTTP, 5000)
PEER = ListeningAddress(WireProtocol.TCPROS, "10.0.0.7", 6000)


@pytest.mark.parametrize(
    ("uri", "protocol", "found"),
    [
        ("http://10.0.0.7:6000/", WireProtocol.HTTP, ListeningAddress(WireProtocol.HTTP, "10.0.0.7", 6000)),
        (
            "rosrpc://[fd99::2]:6000",
            WireProtocol.TCPROS,
            ListeningAddress(WireProtocol.TCPROS, "fd99::2", 6000),
        ),
        (
            "http://10.0.0.7:6000/via",
            WireProtocol.HTTP,
            ListeningAddress(WireProtocol.HTTP, "10.0.0.7", 6000, forwarded_port=True),
        ),
        (
            "rosrpc://10.0.0.7:6000/via",
            WireProtocol.TCPROS,
            ListeningAddress(WireProtocol.TCPROS, "10.0.0.7", 6000),
        ),
        ("rosrpc://10.0.0.7:6000", WireProtocol.HTTP, None),
        ("http://10.0.0.7/", WireProtocol.HTTP, None),
        ("http://:6000/", WireProtocol.HTTP, None),
        ("", WireProtocol.HTTP, None),
        (7, WireProtocol.HTTP, None),
    ],
)
def test_uris_are_parsed(uri: object, protocol: WireProtocol, found: ListeningAddress | None) -> None:
    assert parse_endpoint(uri, protocol) == found


def test_endpoints_are_written_as_in_ros() -> None:
    assert SLAVE.uri == "http://127.0.0.1:5000/"
    assert ListeningAddress(WireProtocol.TCPROS, "fd99::2", 6000).uri == "rosrpc://[fd99::2]:6000"


@pytest.mark.parametrize("uri", ["http://10.0.0.7:6000/via", "http://[fd99::2]:6000/via"])
def test_a_forwarded_port_stays_one(uri: str) -> None:
    """`rosnode cleanup` sends the master what `lookupNode` answered."""
    found = parse_endpoint(uri, WireProtocol.HTTP)
    assert found is not None
    assert found.uri == uri
    endpoints = EndpointMap(found.host)
    local = endpoints.add_egress(found, 8000)
    assert local == local_endpoint(WireProtocol.HTTP, 8000)
    assert endpoints.peer_at(local) == found
    endpoints.add_ingress(SLAVE, found.port)
    assert endpoints.program_at(found) is None  # a forwarded port is no program of this host


def test_endpoints_are_mapped_both_ways() -> None:
    endpoints = EndpointMap("robot.local")
    outside = endpoints.add_ingress(SLAVE, 7000)
    assert outside.uri == "http://robot.local:7000/"
    assert endpoints.program_at(outside) == SLAVE
    assert endpoints.program_at(PEER) is None
    egress = endpoints.add_egress(PEER, 8000)
    assert egress == local_endpoint(WireProtocol.TCPROS, 8000)
    assert endpoints.peer_at(egress) == PEER
    assert endpoints.peer_at(local_endpoint(WireProtocol.HTTP, 8000)) is None
    assert endpoints.peer_at(SLAVE) is None
    endpoints.remove_ingress(SLAVE, 7000)
    endpoints.remove_egress(8000)
    assert endpoints.program_at(outside) is None
    assert endpoints.peer_at(egress) is None


def test_a_program_gets_its_own_uri_as_it_wrote_it() -> None:
    endpoints = EndpointMap("robot.local")
    assert endpoints.own_uri(SLAVE) == SLAVE.uri
    endpoints.set_own_uri(SLAVE, "http://localhost:5000")
    assert endpoints.own_uri(SLAVE) == "http://localhost:5000"


def test_programs_get_the_loopback_host_name() -> None:
    endpoints = EndpointMap("fd99::1", "localhost")
    assert endpoints.add_egress(PEER, 8000).uri == "rosrpc://localhost:8000"
    assert endpoints.peer_at(local_endpoint(WireProtocol.TCPROS, 8000)) == PEER
    assert endpoints.own_uri(SLAVE) == "http://localhost:5000/"


def test_whose_topics_are_at_an_endpoint_is_known_while_a_port_leads_there() -> None:
    map_, api = EndpointMap("robot.local"), ListeningAddress(WireProtocol.HTTP, "10.0.0.7", 6000)
    topics = ListeningAddress(WireProtocol.TCPROS, "10.0.0.7", 6001)
    assert map_.api_of(topics) is None
    map_.add_egress(topics, 8000)
    map_.set_api(topics, api)
    assert (map_.api_of(topics), map_.api_of(api)) == (api, None)
    for port in (8001, 8000, 8000):
        map_.remove_egress(port)
    assert map_.api_of(topics) is None

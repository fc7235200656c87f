"""The connections a node makes: whom it reaches, and whom it refuses before it sends anything."""

from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

import pytest

from ca.certificates import Identity
from ca.errors import Revoked
from rossec.errors import AnswerRefused, ConfigurationError, ConnectionHeaderRefused, IdentityRefused
from rossec.net.aio import SecureContext, SecureServer, SecureStream, WireProtocol, serve
from rossec.net.aio.client import connect
from rossec.net.aio.server import Handler
from rossec.net.rpc.calls import RpcClient, serve_calls
from rossec.participant.connections import Dialer, OwnAddresses
from rossec.ros.xmlrpc import Fault
from tests.support.forwarded_ports import forwarded_port
from tests.support.site import Site

HOST, TOPIC = "127.0.0.1", "/scan"


class Talker:
    """A node whose slave API answers `requestTopic` with `answer`."""

    def __init__(self, site: Site, name: str = "/talker") -> None:
        self.context = SecureContext(site.enroll(name).credentials(), site.anchor.verify)
        self.calls: list[tuple[str, tuple[object, ...]]] = []
        self.peers: list[str] = []
        self.topics = self.listen(self.wait, WireProtocol.TCPROS)
        self.api = self.listen(self.serve_api, WireProtocol.HTTP)
        self.answer: object = [1, "", ["TCPROS", HOST, self.topics.port]]

    def listen(self, handler: Handler[Identity], protocol: WireProtocol) -> SecureServer[Identity]:
        return serve(handler, HOST, 0, self.context, protocol)

    async def wait(self, stream: SecureStream[Identity]) -> None:
        self.peers.append(stream.peer.name)
        await stream.receive()

    async def serve_api(self, stream: SecureStream[Identity]) -> None:
        await serve_calls(stream, self.dispatch)

    def dispatch(self, method: str, params: tuple[object, ...], _: Identity) -> object:
        self.calls.append((method, params))
        if method != "requestTopic":
            raise Fault(1, "no such method")
        return self.answer

    @property
    def uri(self) -> str:
        return f"http://{HOST}:{self.api.port}/"


@pytest.fixture
def site(tmp_path: Path) -> Site:
    return Site(tmp_path / "site")


@pytest.fixture
async def talker(site: Site) -> AsyncIterator[Talker]:
    talker = Talker(site)
    async with talker.topics, talker.api:
        yield talker


class Checked:
    """Whom the node was asked about; those in `revoked` are refused."""

    def __init__(self) -> None:
        self.asked: list[str] = []
        self.revoked: set[str] = set()

    def __call__(self, peer: Identity, _now: int) -> None:
        self.asked.append(peer.name)
        if peer.name in self.revoked:
            raise Revoked(f"{peer.name} is revoked")


@pytest.fixture
def checked() -> Checked:
    return Checked()


@pytest.fixture
async def dialer(site: Site, checked: Checked, monkeypatch: pytest.MonkeyPatch) -> AsyncIterator[Dialer]:
    made: list[SecureStream[Identity]] = []

    async def noted(*given: Any, **named: Any) -> SecureStream[Identity]:
        made.append(await connect(*given, **named))
        return made[-1]

    monkeypatch.setattr("rossec.participant.connections.connect", noted)
    context = SecureContext(site.enroll("/viewer").credentials(), site.anchor.verify)
    yield Dialer("/viewer", context, checked)
    for stream in made:  # a peer that is asked for a topic is left to close in its own time
        stream.abort("the test is over")


async def test_a_topic_is_requested_and_then_connected(
    talker: Talker, dialer: Dialer, checked: Checked
) -> None:
    stream = await dialer.topic(talker.uri, TOPIC)
    assert stream.peer.name == "/talker"
    assert talker.calls == [("requestTopic", ("/viewer", TOPIC, [["TCPROS"]]))]
    assert checked.asked == ["/talker", "/talker"]  # of its API, and of its TCPROS port
    await stream.close()


async def test_a_service_is_connected_at_its_own_uri(
    talker: Talker, dialer: Dialer, checked: Checked
) -> None:
    stream = await dialer.service(f"rosrpc://{HOST}:{talker.topics.port}")
    assert (stream.peer.name, checked.asked) == ("/talker", ["/talker"])
    await stream.close()
    with pytest.raises(ConfigurationError, match="does not begin with rosrpc://"):
        await dialer.service(talker.uri)


async def test_the_caller_of_an_api_checks_the_peer_itself(
    talker: Talker, dialer: Dialer, checked: Checked
) -> None:
    stream = await dialer.rpc(HOST, talker.api.port)
    assert await RpcClient(stream).ask("requestTopic") == ["TCPROS", HOST, talker.topics.port]
    assert checked.asked == []
    await stream.close()


async def test_nothing_is_sent_to_a_revoked_peer(talker: Talker, dialer: Dialer, checked: Checked) -> None:
    checked.revoked.add("/talker")
    for attempt in (dialer.topic(talker.uri, TOPIC), dialer.service(f"rosrpc://{HOST}:{talker.topics.port}")):
        with pytest.raises(Revoked):
            await attempt
    assert talker.calls == []


@pytest.mark.parametrize(
    "answer",
    [
        [],
        0,
        ["UDPROS", HOST, 1],
        ["TCPROS", HOST],
        ["TCPROS", 5, 1],
        ["TCPROS", HOST, 0],
        ["TCPROS", HOST, 65536],
        ["TCPROS", HOST, "80"],
    ],
)
async def test_an_answer_without_a_connection_is_refused(
    talker: Talker, dialer: Dialer, answer: object
) -> None:
    talker.answer = [1, "", answer]
    with pytest.raises(ConnectionHeaderRefused, match=f"/talker offers no connection for {TOPIC}"):
        await dialer.topic(talker.uri, TOPIC)
    talker.answer = [0, "no such topic", answer]
    with pytest.raises(AnswerRefused, match="no such topic"):
        await dialer.topic(talker.uri, TOPIC)
    assert talker.peers == []


async def test_a_node_is_not_sent_back_to_itself(site: Site, talker: Talker) -> None:
    own = OwnAddresses()
    own.add_ports(HOST, talker.topics.port)
    dialer = Dialer("/talker", talker.context, lambda *_: None, own)
    with pytest.raises(IdentityRefused):  # this node's own certificate, at another address
        await dialer.topic(talker.uri, TOPIC)
    own.add_ports(HOST, talker.api.port)
    stream = await dialer.topic(talker.uri, TOPIC)
    assert stream.peer.name == "/talker"
    await stream.close()
    viewer = SecureContext(site.enroll("/viewer").credentials(), site.anchor.verify)
    misled = OwnAddresses()
    misled.add_ports(HOST, talker.topics.port)
    with pytest.raises(ConnectionHeaderRefused, match="sends this node to itself"):
        await Dialer("/viewer", viewer, lambda *_: None, misled).topic(talker.uri, TOPIC)


async def test_behind_a_relays_forwarded_port_the_topic_is_at_the_forwarded_port(
    talker: Talker, dialer: Dialer, checked: Checked
) -> None:
    talker.answer = [1, "", ["TCPROS", "192.0.2.1", 9]]  # an address of its own network
    with forwarded_port(talker.api.port, talker.topics.port) as found:
        stream = await dialer.topic(found.uri, TOPIC)
        assert stream.peer.name == "/talker"
        await stream.close()
    assert found.opened == [WireProtocol.HTTP, WireProtocol.TCPROS]
    assert checked.asked == ["/talker", "/talker"]


async def test_a_node_behind_a_forwarded_port_that_offers_no_connection_is_refused(
    talker: Talker, dialer: Dialer
) -> None:
    talker.answer = [1, "", ["UDPROS", HOST, 1]]
    no_connection = pytest.raises(ConnectionHeaderRefused, match="offers no connection")
    with forwarded_port(talker.api.port, talker.topics.port) as found, no_connection:
        await dialer.topic(found.uri, TOPIC)
    assert found.opened == [WireProtocol.HTTP]


async def test_a_gateway_is_asked_for_what_it_serves(site: Site, dialer: Dialer) -> None:
    gateway = Talker(site, "/gateway")
    async with gateway.topics, gateway.api:
        stream = await dialer.topic(gateway.uri, "/remote/hospital/scan")
        served = ("/viewer", "/gateway/hospital/scan", [["TCPROS"]])
        assert gateway.calls == [("requestTopic", served)]
        await stream.close()


async def test_a_topic_of_another_origin_is_requested_by_its_name_there(
    talker: Talker, dialer: Dialer
) -> None:
    stream = await dialer.topic(talker.uri, "/remote/hospital/scan")
    assert talker.calls == [("requestTopic", ("/viewer", "/scan", [["TCPROS"]]))]
    await stream.close()
    talker.answer = [1, "", []]
    with pytest.raises(ConnectionHeaderRefused, match="offers no connection for hospital:/scan"):
        await dialer.topic(talker.uri, "/remote/hospital/scan")

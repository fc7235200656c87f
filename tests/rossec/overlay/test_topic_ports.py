"""Where a node's topics are: the node itself says so, to a relay that made sure who it is."""

import asyncio
from collections.abc import AsyncIterator
from pathlib import Path

import pytest

from ca.certificates import Identity
from ca.errors import Revoked
from rossec.errors import RelayRefused, RossecError
from rossec.net.aio import SecureContext, SecureServer, SecureStream, WireProtocol, serve
from rossec.net.rpc.calls import serve_calls
from rossec.overlay import relay as module
from rossec.overlay.relay import TopicPorts
from rossec.ros.names import PORTS
from rossec.ros.xmlrpc import Fault
from tests.support.site import Site


class Robot:
    """A node that says where its topics are."""

    def __init__(self, site: Site, name: str = "/robot", *, wildcard: bool = False) -> None:
        home = site.enroll(name, wildcard=wildcard)
        self.answer: object = [1, "", [4711]]
        self.calls: list[tuple[object, ...]] = []
        context = SecureContext(home.credentials(), site.anchor.verify)
        self.api: SecureServer[Identity] = serve(self._serve, "127.0.0.1", 0, context, WireProtocol.HTTP)

    async def _serve(self, stream: SecureStream[Identity]) -> None:
        await serve_calls(stream, self._dispatch)

    def _dispatch(self, method: str, params: tuple[object, ...], peer: Identity) -> object:
        self.calls.append((method, *params, peer.name))
        if isinstance(self.answer, Fault):
            raise self.answer
        return self.answer


@pytest.fixture
def site(tmp_path: Path) -> Site:
    return Site(tmp_path / "home")


@pytest.fixture
async def robot(site: Site) -> AsyncIterator[Robot]:
    found = Robot(site)
    async with found.api:
        yield found


def ports_of(site: Site, *, revoked: bool = False) -> TopicPorts:
    def check(_peer: Identity, _now: int) -> None:
        if revoked:
            raise Revoked("revoked")

    context = SecureContext(site.enroll("/relay").credentials(), site.anchor.verify)
    return TopicPorts(context, "/relay", check)


async def ask(ports: TopicPorts, robot: Robot, name: str = "/robot") -> int:
    address, port = await ports.of(name, "localhost", robot.api.port)
    assert address == "127.0.0.1"
    return port


async def test_the_node_is_asked_once_in_a_while(
    site: Site, robot: Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    ports = ports_of(site)
    assert await ask(ports, robot) == await ask(ports, robot) == 4711
    assert robot.calls == [(PORTS, "/relay", "/relay")]
    robot.answer = [1, "", [4712]]
    ports.forget("/robot", "localhost", robot.api.port)
    assert await ask(ports, robot) == 4712
    robot.answer = [1, "", [4713]]
    monkeypatch.setattr(module, "KEPT_SECONDS", -1.0)
    ports.forget("/robot", "localhost", robot.api.port)
    assert await ask(ports, robot) == await ask(ports, robot) == 4713
    assert len(robot.calls) == 4


async def provided(site: Site, name: str = "/robot", *, revoked: bool = False) -> object:
    """What is found at the address of a service that this node provides."""
    called: list[str] = []

    async def note(stream: SecureStream[Identity]) -> None:
        called.append(stream.peer.name)

    context = SecureContext(site.enroll(name).credentials(), site.anchor.verify)
    ports = ports_of(site, revoked=revoked)
    async with serve(note, "127.0.0.1", 0, context, WireProtocol.TCPROS) as server:
        place = await ports.provider("localhost", server.port)
        assert place == await ports.provider("localhost", server.port)
        assert called == ["/relay"]
        ports.forget("/clock", "localhost", server.port)
        assert place == await ports.provider("localhost", server.port)
        assert called == ["/relay"] * 2
        return place == ("127.0.0.1", server.port)


async def test_at_the_address_of_a_service_some_node_answered(site: Site) -> None:
    assert await provided(site)


async def test_the_provider_of_a_service_is_not_revoked(site: Site) -> None:
    with pytest.raises(Revoked):
        await provided(site, revoked=True)


async def test_a_program_at_the_address_of_a_service_is_no_provider(site: Site) -> None:
    async def echo(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        writer.write(await reader.read(100))
        writer.close()

    server = await asyncio.start_server(echo, "127.0.0.1", 0)
    async with server:
        with pytest.raises(RossecError):
            await ports_of(site).provider("127.0.0.1", server.sockets[0].getsockname()[1])


async def test_what_is_known_of_nodes_is_bounded(
    site: Site, robot: Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "MOST", 1)
    ports = ports_of(site)
    await ask(ports, robot)
    with pytest.raises(RelayRefused):
        await ask(ports, robot, "/other")
    await ask(ports, robot)
    assert len(robot.calls) == 2


async def test_an_anonymous_node_is_known_by_its_tail(site: Site) -> None:
    robot = Robot(site, "/rviz", wildcard=True)
    async with robot.api:
        assert await ask(ports_of(site), robot, "/rviz_17") == 4711


async def test_another_node_at_the_address_is_not_asked(site: Site, robot: Robot) -> None:
    with pytest.raises(RelayRefused, match="/robot answers at the address that /camera"):
        await ask(ports_of(site), robot, "/camera")
    assert robot.calls == []


async def test_a_revoked_node_is_not_asked(site: Site, robot: Robot) -> None:
    with pytest.raises(Revoked):
        await ask(ports_of(site, revoked=True), robot)
    assert robot.calls == []


@pytest.mark.parametrize(
    "answer",
    [
        [1, "", []],
        [1, "", [0]],
        [1, "", [1 << 16]],
        [1, "", [True]],
        [1, "", ["4711"]],
        [1, "", [4711, 4712]],
        [1, "", 4711],
    ],
    ids=str,
)
async def test_an_answer_that_is_no_port(site: Site, robot: Robot, answer: object) -> None:
    robot.answer = answer
    with pytest.raises(RelayRefused, match="/robot does not say"):
        await ask(ports_of(site), robot)


@pytest.mark.parametrize("answer", [Fault(1, "no such method"), [-1, "not for you", 0]], ids=str)
async def test_an_older_node_or_one_that_refuses(site: Site, robot: Robot, answer: object) -> None:
    robot.answer = answer
    ports = ports_of(site)
    with pytest.raises(RossecError):
        await ask(ports, robot)
    robot.answer = [1, "", [4711]]
    assert await ask(ports, robot) == 4711

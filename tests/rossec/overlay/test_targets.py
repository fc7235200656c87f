"""Where a stream leads: only where the own master says, and never as somebody near."""

import asyncio
import socket
from collections.abc import Iterator
from typing import Any, cast

import pytest

from ca.errors import HintedError
from rossec.channel.opening import WireProtocol, first_bytes
from rossec.errors import ProtocolViolation, RelayRefused, StreamRefused
from rossec.host.addresses import is_near, is_relayed, source_for
from rossec.overlay import relay as module
from rossec.overlay.mux import MASTER, NODE, SERVICE, StreamTarget
from rossec.overlay.relay import LinkPeer, Targets, dial_from
from tests.support.relays import carried, linked

PEER = LinkPeer("clinic", "/remote/clinic/relay")
SOURCE = source_for(PEER.name)
HTTP, TCPROS = WireProtocol.HTTP, WireProtocol.TCPROS


class SiteOfTargets:
    """A master's answers, ports of nodes, and listeners; who connected from where."""

    def __init__(self) -> None:
        self.asked: list[tuple[str, str, str]] = []
        self.forgotten: list[str] = []
        self.host = "127.0.0.1"
        self.api = socket.create_server(("127.0.0.1", 0))
        self.topics = socket.create_server(("127.0.0.1", 0))
        for each in (self.api, self.topics):
            each.setblocking(False)
        self.topics_port: int = self.topics.getsockname()[1]

    async def resolve(self, domain: str, kind: str, name: str) -> tuple[str, int]:
        self.asked.append((domain, kind, name))
        if name == "/hidden":
            raise StreamRefused("/master: no such target")
        listener = self.topics if name == "/database" else self.api
        return self.host, listener.getsockname()[1]

    async def of(self, name: str, host: str, port: int) -> tuple[str, int]:
        assert (host, port) == (self.host, self.api.getsockname()[1])
        if name == "/impostor":
            raise RelayRefused("/other answers at the address that /impostor registered")
        return "127.0.0.1", self.topics_port

    async def provider(self, host: str, port: int) -> tuple[str, int]:
        assert host == self.host
        if port == self.topics_port:
            raise RelayRefused("nobody speaks rossec there")
        return "127.0.0.1", port

    def forget(self, name: str, host: str, port: int) -> None:
        self.forgotten.append(name)

    async def reach(self, target: StreamTarget, opening: bytes) -> tuple[bytes, str]:
        """What the program behind the target gets first, and from which address."""
        targets = Targets(self.resolve, cast("Any", self))
        listeners = [each for each in (self.api, self.topics) if each.fileno() >= 0]
        loop = asyncio.get_running_loop()
        async with linked(targets.dial_for(PEER)) as link, carried(link.caller, target) as ends:
            ends[1].write(opening)
            accepting = [asyncio.ensure_future(loop.sock_accept(each)) for each in listeners]
            closed = asyncio.ensure_future(ends[0].read(1))
            done, pending = await asyncio.wait(
                [*accepting, closed], return_when="FIRST_COMPLETED", timeout=20
            )
            for task in pending:
                task.cancel()
            if closed in done:
                closed.result()
            index, task = next(pair for pair in enumerate(accepting) if pair[1] in done)
            sock, where = task.result()
            with sock:
                got = await loop.sock_recv(sock, 1000)
        return b"api " * (index == 0) + got, where[0]


@pytest.fixture
def site() -> Iterator[SiteOfTargets]:
    found = SiteOfTargets()
    with found.api, found.topics:
        yield found


@pytest.mark.parametrize(
    ("target", "protocol", "api"),
    [
        (StreamTarget(MASTER, "/master"), HTTP, True),
        (StreamTarget(NODE, "/robot"), HTTP, True),
        (StreamTarget(NODE, "/robot"), TCPROS, False),
        (StreamTarget(SERVICE, "/clock"), TCPROS, True),
    ],
    ids=["master", "slave API", "topics", "service"],
)
async def test_the_first_bytes_say_which_port(
    site: SiteOfTargets, target: StreamTarget, protocol: WireProtocol, api: bool
) -> None:
    opening = first_bytes(protocol)
    got, source = await site.reach(target, opening)
    assert got == b"api " * api + opening
    assert source == SOURCE
    assert is_relayed(source)
    assert not is_near(source, "127.0.0.1")
    assert site.asked == [("clinic", *target)]


@pytest.mark.parametrize(
    ("target", "opening"),
    [
        (StreamTarget(MASTER, "/master"), first_bytes(TCPROS)),
        (StreamTarget(SERVICE, "/clock"), first_bytes(HTTP)),
        (StreamTarget(NODE, "/robot"), b"POST / HTTP/1.1\r\nContent-length: 0\r\n\r\n"),
        (StreamTarget(NODE, "/robot"), b"\x30\0\0\0\x2c\0\0\0message_definition=string data"),
        (StreamTarget(NODE, "/robot"), b"\xff\xff\xff\xffSSH-2.0"),
        (StreamTarget(NODE, "/hidden"), first_bytes(HTTP)),
        (StreamTarget(NODE, "/impostor"), first_bytes(HTTP)),
        (StreamTarget(NODE, "/impostor"), first_bytes(TCPROS)),
        (StreamTarget(SERVICE, "/database"), first_bytes(TCPROS)),
    ],
    ids=[
        "master by TCPROS",
        "service by HTTP",
        "plain XML-RPC",
        "plain TCPROS",
        "another protocol",
        "what the master refuses",
        "another node at the address",
        "its topics",
        "a service where no node is",
    ],
)
async def test_nothing_is_connected_for(site: SiteOfTargets, target: StreamTarget, opening: bytes) -> None:
    with pytest.raises(ConnectionResetError):
        await site.reach(target, opening)
    assert site.forgotten == []


@pytest.mark.parametrize(
    ("target", "protocol"),
    [
        (StreamTarget(NODE, "/robot"), HTTP),
        (StreamTarget(NODE, "/robot"), TCPROS),
        (StreamTarget(SERVICE, "/clock"), TCPROS),
    ],
    ids=["slave API", "topics", "service"],
)
async def test_a_host_is_resolved_once_and_then_it_is_connected_where_the_node_was(
    site: SiteOfTargets, target: StreamTarget, protocol: WireProtocol
) -> None:
    site.host = "rebound.invalid"  # resolved anew, it would be somewhere else
    got, _ = await site.reach(target, first_bytes(protocol))
    assert got.endswith(first_bytes(protocol))


async def test_a_node_that_is_gone_is_asked_again_next_time(site: SiteOfTargets) -> None:
    site.topics.close()
    with pytest.raises(ConnectionResetError):
        await site.reach(StreamTarget(NODE, "/robot"), first_bytes(TCPROS))
    assert site.forgotten == ["/robot"]


@pytest.mark.parametrize("listen", ["127.0.0.1", "::"])
@pytest.mark.parametrize("host", ["127.0.0.1", "localhost", "::1", "0.0.0.0"])
async def test_a_target_on_this_host_sees_by_whom_it_is_reached(listen: str, host: str) -> None:
    family = socket.AF_INET6 if ":" in listen else socket.AF_INET
    with socket.create_server((listen, 0), family=family, dualstack_ipv6=listen == "::") as server:
        server.setblocking(False)
        with await dial_from(SOURCE, host, server.getsockname()[1]):
            sock, where = server.accept()
            sock.close()
    assert where[0].removeprefix("::ffff:") == SOURCE
    assert is_relayed(where[0])


async def test_an_address_that_turns_out_to_be_this_host_is_dropped(monkeypatch: pytest.MonkeyPatch) -> None:
    """For example a name that is resolved to another address the second time."""

    async def dial(_host: str, port: int, _within: float) -> socket.socket:
        sock = socket.create_connection(("127.0.0.1", port))
        dialled.append(sock)
        return sock

    dialled: list[socket.socket] = []
    monkeypatch.setattr(module, "dial", dial)
    server = socket.create_server(("127.0.0.1", 0))
    with server, pytest.raises(RelayRefused, match="this host after all"):
        await dial_from(SOURCE, "192.0.2.77", server.getsockname()[1])
    assert dialled[0].fileno() == -1


async def test_another_host_is_dialled_as_usual(monkeypatch: pytest.MonkeyPatch) -> None:
    class Elsewhere(socket.socket):
        def getpeername(self) -> tuple[str, int]:
            return "192.0.2.77", 11311

    async def dial(host: str, port: int, within: float) -> socket.socket:
        assert (host, port, within) == ("192.0.2.77", 11311, module.CONNECT_SECONDS)
        return Elsewhere()

    monkeypatch.setattr(module, "dial", dial)
    with await dial_from(SOURCE, "192.0.2.77", 11311) as sock:
        assert sock.fileno() >= 0


async def test_nobody_is_at_the_port() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = server.getsockname()[1]
    with pytest.raises(ConnectionRefusedError):
        await dial_from(SOURCE, "127.0.0.1", port)


def test_refusals_have_a_type_that_is_logged() -> None:
    assert issubclass(RelayRefused, HintedError)
    assert issubclass(ProtocolViolation, HintedError)

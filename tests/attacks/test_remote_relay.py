"""A relay of another domain that is admitted, and asks for more: attacks on the relay it calls.

Two whole sites in one process. The attacker has the identity of the home's relay, makes links to
the inbox that the office told it, and writes what units it likes.
"""

import asyncio
import contextlib
import socket
from collections.abc import AsyncIterator, Iterator
from pathlib import Path

import pytest

from ca.certificates import Identity
from ca.encoding import head as cbor_head
from rossec.channel.opening import WireProtocol, first_bytes
from rossec.errors import ChannelError
from rossec.master.state.registry import NodeRef
from rossec.net.aio import SecureStream
from rossec.net.rpc.calls import RpcClient
from rossec.overlay.mux import (
    MASTER,
    MAX_DATA,
    MOST,
    NODE,
    SERVICE,
    STREAMS,
    YOUNG,
    Data,
    Reset,
    StreamTarget,
    Unit,
    credit_unit,
    data_head,
    end_unit,
    open_unit,
    read_units,
    reset_unit,
)
from tests.support.relayedsites import RelayedSite, two_sites

Link = SecureStream[Identity]
Sites = tuple[RelayedSite, RelayedSite]
THE_MASTER = StreamTarget(MASTER, "/master")
HTTP = first_bytes(WireProtocol.HTTP)


@pytest.fixture
async def sites(tmp_path: Path) -> AsyncIterator[Sites]:
    async with two_sites(tmp_path) as both:
        yield both


@contextlib.asynccontextmanager
async def attacker(sites: Sites) -> AsyncIterator[Link]:
    """A link to the office, as the home's relay."""
    home, office = sites
    link = await home.network.dial(office.relay_inbox(home))
    try:
        yield link
    finally:
        link.abort("the attack is over")


def data(stream: int, payload: bytes) -> bytes:
    return data_head(stream, len(payload)) + payload


async def answers(link: Link, count: int) -> list[Unit]:
    """The next units of the office's relay."""
    found: list[Unit] = []
    async with asyncio.timeout(20):
        while len(found) < count:
            found += read_units(await link.receive())
    return found


async def ends(link: Link) -> None:
    """The office's relay ends the link."""
    async with asyncio.timeout(20):
        await link.wait_ended()


async def honest_call(sites: Sites) -> None:
    """The home's real relay is served all the while, on a link of its own."""
    home, office = sites
    forwarded_port = await home.forwarded_port("office", "master", "/master")
    client = RpcClient(await home.through(forwarded_port))
    assert await client.ask("getUri", "/master") == office.master.server.uri
    await client.close()


@contextlib.contextmanager
def listening() -> Iterator[socket.socket]:
    """A program of the office's host that is in no graph."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        server.setblocking(False)
        yield server


@pytest.mark.attack("relay-beyond-exports")
async def test_targets_outside_of_what_is_shown_are_refused_alike(sites: Sites) -> None:
    """Unknown, not exported, a master's parameter server, the relay itself: one answer."""
    _, office = sites
    office.master.take_domains(office.trust(sites[0], exported=()))
    office.site.publish("/robot", "/robot/pose")
    async with office.master.node("/robot") as robot, attacker(sites) as link:
        await robot.publisher("/robot/pose", "std_msgs/String")
        wanted = [
            StreamTarget(NODE, "/robot"),
            StreamTarget(NODE, "/nobody"),
            StreamTarget(NODE, "/relay"),
            StreamTarget(NODE, "/master"),
            StreamTarget(SERVICE, "/robot/stop"),
            StreamTarget(MASTER, "/robot"),
            StreamTarget(NODE, "/remote/home/robot"),
        ]
        for number, target in enumerate(wanted):
            await link.send(open_unit(number, target) + data(number, HTTP))
        found = await answers(link, len(wanted))
        assert sorted(found, key=lambda unit: unit.stream) == [Reset(number) for number in range(len(wanted))]
    await honest_call(sites)


@pytest.mark.attack("relay-beyond-exports")
async def test_an_address_is_no_target(sites: Sites) -> None:
    with listening() as program:
        where = f"127.0.0.1:{program.getsockname()[1]}"
        for name in (where, f"http://{where}/", f"/{where}", "/robot@127.0.0.1", "/../robot"):
            head = b"\x84\x00\x00\x01" + cbor_head(0x60, len(name))
            async with attacker(sites) as link:
                await link.send(head + name.encode())
                await ends(link)
        with pytest.raises(BlockingIOError):
            program.accept()
    await honest_call(sites)


@pytest.mark.attack("relay-beyond-exports")
async def test_a_node_that_registers_anothers_address_brings_nobody_there(sites: Sites) -> None:
    """An accomplice inside points its own registration at a program of the office's network."""
    _, office = sites
    office.site.publish("/robot", "/robot/pose")
    with listening() as program:
        uri = f"http://127.0.0.1:{program.getsockname()[1]}/"
        async with office.master.node("/robot") as robot, attacker(sites) as link:
            await robot.publisher("/robot/pose", "std_msgs/String")
            registry = office.master.server.state.registry
            (node,) = [each for each in registry.nodes() if each.name == "/robot"]
            registry.register_publisher("/robot/scan", "std_msgs/String", node._replace(uri=uri))
            await link.send(open_unit(0, StreamTarget(NODE, "/robot")) + data(0, HTTP + b"GET / HTTP/1.1"))
            sock, _ = await asyncio.get_running_loop().sock_accept(program)
            with sock:  # the relay's own handshake, from the relay's own address
                assert sock.getpeername()[0] == "127.0.0.1"
                got = await asyncio.get_running_loop().sock_recv(sock, 4096)
                assert b"GET / HTTP/1.1" not in got
            assert await answers(link, 1) == [Reset(0)]
            with pytest.raises(BlockingIOError):
                program.accept()


@pytest.mark.attack("relay-beyond-exports")
async def test_a_service_registered_at_a_program_brings_nobody_there(sites: Sites) -> None:
    """The accomplice registers a name that means loopback at the relay: no check of URIs sees it.

    Behind its opening the attacker would say what it likes to a program that skips what it does
    not know, as many do.
    """
    _, office = sites
    office.site.publish("/robot", "/robot/pose")
    with listening() as program:
        uri = f"rosrpc://localhost:{program.getsockname()[1]}"
        node = NodeRef("/robot", "http://10.0.0.3:4711/", b"robot")
        office.master.server.state.registry.register_service("/robot/stop", uri, node)
        async with attacker(sites) as link:
            opening = first_bytes(WireProtocol.TCPROS)
            await link.send(open_unit(0, StreamTarget(SERVICE, "/robot/stop")))
            await link.send(data(0, opening + b"\nFLUSHALL\n"))
            sock, _ = await asyncio.get_running_loop().sock_accept(program)
            with sock:
                assert b"FLUSHALL" not in await asyncio.get_running_loop().sock_recv(sock, 4096)
            assert await answers(link, 1) == [Reset(0)]
            with pytest.raises(BlockingIOError):
                program.accept()
    await honest_call(sites)


@pytest.mark.attack("relay-beyond-exports")
async def test_only_callers_of_rossec_are_brought(sites: Sites) -> None:
    _, office = sites
    openings = {
        "a browser": b"GET / HTTP/1.1\r\nHost: x\r\n\r\n",
        "plain XML-RPC": b"POST /RPC2 HTTP/1.1\r\nContent-Length: 5\r\n\r\nhello",
        "ssh": b"SSH-2.0-x\r\n",
        "zeros": bytes(64),
        "TCPROS at the master": first_bytes(WireProtocol.TCPROS),
    }
    async with attacker(sites) as link:
        for number, opening in enumerate(openings.values()):
            await link.send(open_unit(number, THE_MASTER) + data(number, opening))
            assert await answers(link, 1) == [Reset(number)]
    assert len(office.master.server.context.half_open) == 0


@pytest.mark.attack("relay-floods")
async def test_a_flood_of_streams_is_refused_beyond_the_first(sites: Sites) -> None:
    """None says anything; each costs the office nothing but its number."""
    _, office = sites
    async with attacker(sites) as link:
        for number in range(4 * STREAMS):
            await link.send(open_unit(number, StreamTarget(NODE, f"/n{number}")))
        refused = {unit.stream for unit in await answers(link, 4 * STREAMS - YOUNG)}
        assert refused == set(range(YOUNG, 4 * STREAMS))
        assert office.relay.ways()["home"].streams == YOUNG
        await honest_call(sites)
    assert len(office.master.server.context.half_open) == 0


@pytest.mark.attack("relay-floods")
async def test_streams_that_are_broken_off_at_once_have_few_targets_looked_for(sites: Sites) -> None:
    """Opened, answered with an opening, reset: it would cost the attacker 40 bytes each."""
    _, office = sites
    before = len(asyncio.all_tasks())
    most = 0
    async with attacker(sites) as link:
        for number in range(2000):
            await link.send(open_unit(number, StreamTarget(NODE, f"/n{number}")) + data(number, HTTP))
            await link.send(reset_unit(number))
            most = max(most, len(asyncio.all_tasks()) - before)
        await answers(link, 1)
        most = max(most, len(asyncio.all_tasks()) - before)
        assert most < 3 * YOUNG
        await honest_call(sites)
    assert office.relay.ways()["home"].streams == 0


BREACHES = {
    "a number left out": open_unit(1, THE_MASTER),
    "a number again": open_unit(0, THE_MASTER) * 2,
    "never opened": data(0, b"x"),
    "the end of none": end_unit(5),
    "the reset of none": reset_unit(1 << 31),
    "data after the end": open_unit(0, THE_MASTER) + end_unit(0) + data(0, b"x"),
    "two ends": open_unit(0, THE_MASTER) + end_unit(0) * 2,
    "more credit than a link has": open_unit(0, THE_MASTER) + credit_unit(0, MOST),
    "credit that grows": open_unit(0, THE_MASTER) + credit_unit(0, 1 << 31) * 3,
    "not deterministic": b"\x82\x00\x18\x03",
    "garbage": b"\xff" * 1000,
    "a length of 2 GiB": b"\x83\x00\x01\x5a\x7f\xff\xff\xff",
}


@pytest.mark.attack("relay-floods")
async def test_what_breaks_the_rules_ends_the_link_and_no_other(sites: Sites) -> None:
    home, office = sites
    forwarded_port = await home.forwarded_port("office", "master", "/master")
    client = RpcClient(await home.through(forwarded_port))
    for units in BREACHES.values():
        async with attacker(sites) as link:
            await link.send(units)
            await ends(link)
        assert await client.ask("getUri", "/master") == office.master.server.uri
    await client.close()


@pytest.mark.attack("relay-floods")
async def test_bytes_beyond_the_credit_end_the_link(sites: Sites) -> None:
    """The target does not read: a relay that keeps the credit stops, and this one does not."""
    _, office = sites
    with listening() as program:
        uri = f"rosrpc://127.0.0.1:{program.getsockname()[1]}"
        node = NodeRef("/robot", "http://10.0.0.3:4711/", b"robot")
        office.master.server.state.registry.register_service("/robot/stop", uri, node)
        async with attacker(sites) as link:
            await link.send(open_unit(0, StreamTarget(SERVICE, "/robot/stop")))
            await link.send(data(0, first_bytes(WireProtocol.TCPROS)))
            sock, _ = await asyncio.get_running_loop().sock_accept(program)
            with sock, contextlib.suppress(ChannelError):
                for _ in range(1000):
                    await link.send(data(0, bytes(MAX_DATA)))
            await ends(link)
    await honest_call(sites)


@pytest.mark.attack("relay-floods")
async def test_a_relay_that_reads_nothing_stops_nobody(sites: Sites) -> None:
    """It asks the master again and again, and leaves the answers in the network."""
    async with attacker(sites) as link:
        await link.send(open_unit(0, THE_MASTER) + data(0, HTTP))
        link.transport.pause_reading()
        for number in range(1, 20_000):
            with contextlib.suppress(ChannelError):
                if not link.lags:
                    link.write_nowait(open_unit(number, StreamTarget(NODE, "/robot")))
            if number % 500 == 0:
                await asyncio.sleep(0)
        await honest_call(sites)


@pytest.mark.attack("relay-beyond-exports")
async def test_the_positive_control_reaches_the_master(sites: Sites) -> None:
    """The same units, asked for what is shown, begin the master's own handshake."""
    async with attacker(sites) as link:
        await link.send(open_unit(0, THE_MASTER) + data(0, HTTP))
        (unit,) = await answers(link, 1)
        assert isinstance(unit, Data)
        assert bytes(unit.payload).startswith(b"HTTP/1.1 101 Switching Protocols")

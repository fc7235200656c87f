"""Forwarded ports: one port for each target, who may use it, and how a forwarded port is closed."""

import asyncio
import contextlib
import os
import socket
from collections.abc import AsyncIterator

import pytest

from rossec.errors import ConfigurationError, LinkCrowded, StreamRefused
from rossec.host.callers import Callers
from rossec.master.state.forwarded_ports import PeerWay, Target
from rossec.net.aio.client import dial
from rossec.overlay import forwarded_ports as module
from rossec.overlay.forwarded_ports import ForwardedPortTable, OpenPorts
from rossec.overlay.mux import NODE, SERVICE

ROBOT = Target("hospital", NODE, "/robot")
CLOCK = Target("hospital", SERVICE, "/clock")
MASTER = "/master"
WAYS = dict.fromkeys(("hospital", "office"), PeerWay("idle", 0, 0, "", 0))
OTHER = Target("office", NODE, "/robot")


class Carrier:
    """Holds connections until the program ends them."""

    def __init__(self) -> None:
        self.forwarded_ports: list[Target] = []
        self.error: StreamRefused | None = None

    async def carry(self, forwarded_port: Target, sock: socket.socket) -> None:
        self.forwarded_ports.append(forwarded_port)
        sock.setblocking(False)
        with sock:
            if self.error is not None:
                raise self.error
            loop = asyncio.get_running_loop()
            await loop.sock_sendall(sock, b"!")
            await loop.sock_recv(sock, 1)


@contextlib.asynccontextmanager
async def forwarded_ports(
    carrier: Carrier, callers: Callers | OpenPorts | None = None, limit: int = 8
) -> AsyncIterator[ForwardedPortTable]:
    found = ForwardedPortTable(callers or Callers({os.getuid()}), carrier.carry, lambda: WAYS, limit)
    try:
        yield found
    finally:
        await found.close()


async def turned_away(where: tuple[str, int]) -> None:
    sock = await dial(*where, 10)
    with sock, contextlib.suppress(ConnectionResetError):
        assert await asyncio.get_running_loop().sock_recv(sock, 1) == b""


async def enter(where: tuple[str, int]) -> socket.socket:
    """Connect to a forwarded port; it was admitted."""
    sock = await dial(*where, 10)
    async with asyncio.timeout(10):
        assert await asyncio.get_running_loop().sock_recv(sock, 1) == b"!"
    return sock


async def test_each_target_has_a_forwarded_port_of_its_own() -> None:
    carrier = Carrier()
    async with forwarded_ports(carrier) as found:
        places = {
            forwarded_port: await found.open(forwarded_port, MASTER)
            for forwarded_port in (ROBOT, CLOCK, OTHER)
        }
        assert len(set(places.values())) == 3
        assert {host for host, _ in places.values()} == {"127.0.0.1"}
        assert await found.open(ROBOT, MASTER) == places[ROBOT]
        assert set(found.wanted) == set(places)
        for forwarded_port, where in places.items():
            (await enter(where)).close()
            assert carrier.forwarded_ports[-1] == forwarded_port


async def test_programs_of_other_users_are_not_let_in() -> None:
    carrier = Carrier()
    async with forwarded_ports(carrier, Callers({os.getuid() + 1})) as found:
        sock = await dial(*await found.open(ROBOT, MASTER), 10)
        with sock, contextlib.suppress(ConnectionResetError):
            assert await asyncio.get_running_loop().sock_recv(sock, 1) == b""
    assert carrier.forwarded_ports == []


async def test_forwarded_ports_at_an_address_let_everybody_in() -> None:
    carrier = Carrier()
    async with forwarded_ports(carrier, OpenPorts("127.0.0.5", "relay.example")) as found:
        host, port = await found.open(ROBOT, MASTER)
        assert host == "relay.example"
        (await enter(("127.0.0.5", port))).close()
        with pytest.raises(ConnectionRefusedError):
            await dial("127.0.0.1", port, 10)
    assert OpenPorts("192.0.2.7").loopback.host == "192.0.2.7"


async def test_a_closed_forwarded_port_lets_nobody_in_and_keeps_who_is_inside() -> None:
    carrier = Carrier()
    async with forwarded_ports(carrier) as found:
        where = await found.open(ROBOT, MASTER)
        inside = await enter(where)
        found.release(ROBOT, MASTER)
        found.release(ROBOT, MASTER)
        assert list(found.wanted) == []
        with pytest.raises(ConnectionRefusedError):
            await dial(*where, 10)
        again = await found.open(ROBOT, MASTER)
        assert again != where
        inside.close()
        (await enter(again)).close()


async def test_a_removed_peer_loses_its_forwarded_ports_and_connections() -> None:
    async with forwarded_ports(Carrier()) as found:
        inside = await enter(await found.open(ROBOT, MASTER))
        await found.open(CLOCK, MASTER)
        stays = await enter(await found.open(OTHER, MASTER))
        found.drop_peer("hospital")
        assert list(found.wanted) == [OTHER]
        with inside, stays, contextlib.suppress(ConnectionResetError):
            assert await asyncio.get_running_loop().sock_recv(inside, 1) == b""


async def test_the_idle_forwarded_port_asked_for_least_recently_makes_room() -> None:
    async with forwarded_ports(Carrier(), limit=2) as found:
        first = await enter(await found.open(ROBOT, MASTER))
        where = await found.open(CLOCK, MASTER)
        await found.open(OTHER, MASTER)
        assert list(found.wanted) == [ROBOT, OTHER]
        with pytest.raises(ConnectionRefusedError):
            await dial(*where, 10)
        second = await enter(await found.open(OTHER, MASTER))
        with pytest.raises(ConfigurationError, match="more than 2 addresses") as caught:
            await found.open(CLOCK, MASTER)
        assert "relay" in caught.value.hint
        first.close()
        second.close()


async def test_a_connection_that_cannot_be_carried_is_logged(caplog: pytest.LogCaptureFixture) -> None:
    carrier = Carrier()
    carrier.error = StreamRefused("no link to it", "rossec relay status")
    async with forwarded_ports(carrier) as found:
        for forwarded_port in (ROBOT, CLOCK):
            await turned_away(await found.open(forwarded_port, MASTER))
    assert caplog.messages == [
        "node /robot: not connected to hospital: no link to it (rossec relay status)",
        "service /clock: not connected to hospital: no link to it (rossec relay status)",
    ]


async def test_all_that_find_no_room_are_one_line_of_the_log(caplog: pytest.LogCaptureFixture) -> None:
    carrier = Carrier()
    async with forwarded_ports(carrier) as found:
        for each in (ROBOT, CLOCK, ROBOT):
            carrier.error = LinkCrowded(f"no room for {each.kind} {each.name}", "have fewer")
            await turned_away(await found.open(each, MASTER))
    assert caplog.messages == [
        "a connection: not connected to hospital: no room for node /robot (have fewer)"
    ]


def test_the_pool_is_as_large_as_the_master_allows() -> None:
    from rossec.master.state.forwarded_ports import MAX_FORWARDED_PORTS

    assert module.LIMIT == MAX_FORWARDED_PORTS

"""The forwarded ports of a relay, as several masters want them."""

import asyncio
import socket

import pytest

from rossec.errors import RelayRefused
from rossec.master.state.forwarded_ports import PeerWay, Target
from rossec.overlay.forwarded_ports import ForwardedPortTable, OpenPorts

ROBOT = Target("office", "node", "/robot")
WAYS = {"office": PeerWay("idle", 0, 0, "", 0)}


async def carry(target: Target, sock: socket.socket) -> None:
    """Say what the forwarded port stands for."""
    sock.setblocking(True)
    sock.sendall(" ".join(target).encode())
    sock.close()


def said(port: int) -> str:
    with socket.create_connection(("127.0.0.1", port), 10) as sock:
        return sock.recv(100).decode()


def is_open(port: int) -> bool:
    with socket.socket() as sock:
        return sock.connect_ex(("127.0.0.1", port)) == 0


async def test_a_target_has_one_forwarded_port_whoever_wants_it() -> None:
    table = ForwardedPortTable(OpenPorts("127.0.0.1"), carry, lambda: WAYS)
    forwarded_port = await table.open(ROBOT, "/master")
    assert forwarded_port == await table.open(ROBOT, "/master/kitchen")
    assert forwarded_port.host == "127.0.0.1"
    assert len(table.wanted) == 1
    assert await asyncio.to_thread(said, forwarded_port.port) == "office node /robot"
    table.release(ROBOT, "/master")
    assert is_open(forwarded_port.port)
    table.release(ROBOT, "/master/kitchen")
    table.release(ROBOT, "/master/kitchen")
    await asyncio.sleep(0.1)
    assert not is_open(forwarded_port.port)
    assert len(table.wanted) == 0
    await table.close()


async def test_there_is_no_forwarded_port_to_a_peer_that_is_not_known() -> None:
    table = ForwardedPortTable(OpenPorts("127.0.0.1"), carry, lambda: WAYS)
    with pytest.raises(RelayRefused, match="no relay is called clinic here") as caught:
        await table.open(Target("clinic", "node", "/robot"), "/master")
    assert "rossec relay add clinic FILE" in caught.value.hint
    await table.close()


async def test_the_forwarded_ports_of_a_peer_that_is_gone_are_closed() -> None:
    table = ForwardedPortTable(OpenPorts("127.0.0.1"), carry, lambda: WAYS | {"clinic": WAYS["office"]})
    forwarded_port = await table.open(ROBOT, "/master")
    other = await table.open(ROBOT._replace(peer="clinic"), "/master")
    table.drop_peer("office")
    await asyncio.sleep(0.1)
    assert (is_open(forwarded_port.port), is_open(other.port), len(table.wanted)) == (False, True, 1)
    assert [table.take_dropped("/master") for _ in range(2)] == [{ROBOT}, set()]
    await table.close()
    assert not is_open(other.port)


async def test_a_forwarded_port_that_makes_room_for_another_is_wanted_no_longer() -> None:
    table = ForwardedPortTable(OpenPorts("127.0.0.1"), carry, lambda: WAYS, limit=1)
    await table.open(ROBOT, "/master")
    await table.open(ROBOT._replace(name="/other"), "/master")
    assert len(table.wanted) == 1
    await table.close()

import asyncio
import contextlib
import errno
import os
import socket

import pytest

from rossec.errors import ChannelClosed, ConfigurationError
from rossec.host import local_ports
from rossec.host.callers import Callers
from rossec.host.local_ports import LOOPBACK, Loopback, bind_loopback
from rossec.net.aio.client import dial
from rossec.sidecar.loopback_port import LoopbackPort, PlainStream

ANY_CALLER = Callers({os.getuid()})


async def echo(stream: PlainStream) -> None:
    while True:
        await stream.send(await stream.receive())


async def exchange_hello(port: int) -> bytes:
    stream = PlainStream(await dial("127.0.0.1", port, 10))
    await stream.send(b"hello")
    try:
        return await stream.receive()
    finally:
        await stream.close()


async def test_a_suspended_port_refuses_callers_and_stays_bound() -> None:
    listener = LoopbackPort(ANY_CALLER, echo)
    connections: list[PlainStream] = []
    try:
        for _ in range(2):
            with pytest.raises(ConnectionRefusedError):
                await dial("127.0.0.1", listener.port, 10)
            with pytest.raises(OSError, match="in use"):
                bind_loopback(listener.port)
            listener.open()
            listener.open()
            assert await exchange_hello(listener.port) == b"hello"
            connections.append(PlainStream(await dial("127.0.0.1", listener.port, 10)))
            await connections[-1].send(b"x")
            assert await connections[-1].receive() == b"x"
            listener.suspend()
            with socket.socket() as other:
                other.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
                with pytest.raises(OSError, match="in use"):
                    other.bind(("127.0.0.1", listener.port))
    finally:
        await listener.close()
        for stream in connections:
            await stream.close()
    bind_loopback(listener.port).close()


async def test_a_port_that_is_closed_closes_what_it_has_just_accepted() -> None:
    listener = LoopbackPort(ANY_CALLER, echo)
    listener.open()
    program = PlainStream(await dial("127.0.0.1", listener.port, 10))
    for _ in range(2):  # turns of the loop: it is accepted, its task has not begun
        await asyncio.sleep(0)
    assert listener.connections == 1
    await listener.close()
    with pytest.raises((ChannelClosed, ConnectionError)):
        async with asyncio.timeout(5):
            await program.receive()
    program.abort()


async def test_programs_of_other_users_are_dropped_before_reading() -> None:
    listener = LoopbackPort(Callers({os.getuid() + 1}), echo)
    listener.open()
    try:
        with pytest.raises((ChannelClosed, ConnectionError)):
            await exchange_hello(listener.port)
    finally:
        await listener.close()


async def test_the_connections_of_a_port_are_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(local_ports, "CONNECTIONS", 1)
    listener = LoopbackPort(ANY_CALLER, echo)
    listener.open()
    first = PlainStream(await dial("127.0.0.1", listener.port, 10))
    await first.send(b"x")
    assert await first.receive() == b"x"
    assert listener.connections == 1
    with pytest.raises((ChannelClosed, ConnectionError)):
        await exchange_hello(listener.port)
    first.abort()
    await listener.close()


class Exhausted(socket.socket):
    """Out of descriptors for three calls; counts the calls."""

    calls = 0

    def accept(self) -> tuple[socket.socket, object]:
        Exhausted.calls += 1
        if Exhausted.calls <= 3:
            raise OSError(errno.EMFILE, "too many open files")
        return super().accept()


async def test_accepting_pauses_without_descriptors(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """The socket stays readable: retrying at once would be a busy loop."""
    monkeypatch.setattr(local_ports, "bind_loopback", lambda *_: Exhausted(fileno=bind_loopback().detach()))
    monkeypatch.setattr(local_ports, "PAUSE", 0.05)
    listener = LoopbackPort(ANY_CALLER, echo)
    listener.open()
    assert await exchange_hello(listener.port) == b"hello"
    assert Exhausted.calls == 4
    assert "too many open files" in caplog.text
    listener.suspend()
    listener._start_accepting()  # no effect while suspended
    with pytest.raises(ConnectionRefusedError):
        await dial("127.0.0.1", listener.port, 10)
    await listener.close()


async def test_a_slow_program_slows_the_sender() -> None:
    """Back-pressure: unread bytes stay with the sender, not in our memory."""
    taken = asyncio.Event()
    received = 0

    async def lazy(stream: PlainStream) -> None:
        nonlocal received
        await taken.wait()
        while True:
            received += len(await stream.receive())

    listener = LoopbackPort(ANY_CALLER, lazy)
    listener.open()
    stream = PlainStream(await dial("127.0.0.1", listener.port, 10))
    sending = asyncio.ensure_future(stream.send(b"x" * 32_000_000))
    done, _ = await asyncio.wait({sending}, timeout=0.3)
    assert not done
    taken.set()
    await sending
    await stream.close()
    await listener.close()
    assert received == 32_000_000


async def test_connections_above_the_limit_are_closed(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(local_ports, "CONNECTIONS", 1)
    listener = LoopbackPort(ANY_CALLER, echo)
    listener.open()
    stream = PlainStream(await dial("127.0.0.1", listener.port, 10))
    await stream.send(b"hello")
    assert await stream.receive() == b"hello"
    with pytest.raises(ChannelClosed):
        await exchange_hello(listener.port)
    assert f"too many connections at port {listener.port}" in caplog.text
    await stream.close()
    await listener.close()


async def test_an_error_in_the_check_refuses_the_caller(monkeypatch: pytest.MonkeyPatch) -> None:
    async def crash(_: socket.socket) -> None:
        raise ArithmeticError

    monkeypatch.setattr(ANY_CALLER, "check", crash)
    listener = LoopbackPort(ANY_CALLER, echo)
    listener.open()
    with pytest.raises(ChannelClosed):
        await exchange_hello(listener.port)
    await listener.close()


async def test_binding_fails_when_every_free_port_is_taken(monkeypatch: pytest.MonkeyPatch) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        monkeypatch.setattr(local_ports, "free_port", lambda: port)
        with pytest.raises(OSError, match="in use"):
            bind_loopback()


def resolving(monkeypatch: pytest.MonkeyPatch, here: set[str], names: dict[str, set[str]]) -> None:
    monkeypatch.setattr(local_ports, "is_here", here.__contains__)
    monkeypatch.setattr(local_ports, "_addresses", lambda name: names.get(name, set()))


def test_loopback_is_ipv4_if_possible(monkeypatch: pytest.MonkeyPatch) -> None:
    assert local_ports.find_loopback() == LOOPBACK
    resolving(monkeypatch, {"127.0.0.1", "::1"}, {"localhost": {"::1"}})
    assert local_ports.find_loopback() == LOOPBACK


@pytest.mark.parametrize(
    ("names", "name"),
    [
        ({"localhost": {"::1"}, "ip6-localhost": {"::1"}}, "localhost"),
        ({"localhost": {"::1", "2001:db8::1"}, "ip6-localhost": {"::1"}}, "ip6-localhost"),
    ],
)
def test_without_ipv4_loopback_is_a_name_that_resolves_to_ipv6_alone(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture, names: dict[str, set[str]], name: str
) -> None:
    resolving(monkeypatch, {"::1"}, names)
    assert local_ports.find_loopback() == ("::1", name)
    assert f"no 127.0.0.1: programs get the host name {name} and ROS_IPV6=on" in caplog.text


def test_a_host_without_loopback_gets_a_hint(monkeypatch: pytest.MonkeyPatch) -> None:
    resolving(monkeypatch, set(), {"localhost": {"::1"}})
    with pytest.raises(ConfigurationError, match="this host has no loopback address") as caught:
        local_ports.find_loopback()
    assert caught.value.hint == "ip link set lo up"
    resolving(monkeypatch, {"::1"}, {"localhost": {"::ffff:127.0.0.1"}})
    with pytest.raises(ConfigurationError, match="no name for ::1") as caught:
        local_ports.find_loopback()
    assert caught.value.hint == "write in /etc/hosts: ::1 localhost ip6-localhost"


def test_names_resolve_to_addresses(monkeypatch: pytest.MonkeyPatch) -> None:
    def found(*_: object) -> list[tuple[object, ...]]:
        return [(socket.AF_INET6, socket.SOCK_STREAM, 6, "", ("::1", 0, 0, 0))]

    def missing(*_: object) -> list[tuple[object, ...]]:
        raise socket.gaierror(socket.EAI_NONAME, "no such name")

    monkeypatch.setattr(socket, "getaddrinfo", found)
    assert local_ports._addresses("localhost") == {"::1"}
    monkeypatch.setattr(socket, "getaddrinfo", missing)
    assert local_ports._addresses("localhost") == set()
    assert local_ports.is_here("127.0.0.1")
    assert not local_ports.is_here("192.0.2.1")


async def test_an_ipv6_port_checks_callers_too(caplog: pytest.LogCaptureFixture) -> None:
    """The kernel gives the user at the other end for IPv6 as well."""
    six = Loopback("::1", "localhost")
    for users, answer in ((os.getuid(), b"hello"), (os.getuid() + 1, b"")):
        listener = LoopbackPort(Callers({users}, None, six), echo)
        listener.open()
        reader, writer = await asyncio.open_connection("::1", listener.port)
        writer.write(b"hello")
        with contextlib.suppress(ConnectionError):
            assert await reader.read(5) == answer
        writer.close()
        await listener.close()
    assert "may not use this sidecar" in caplog.text

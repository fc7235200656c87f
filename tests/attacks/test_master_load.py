"""Peers that exhaust the master (M9-M11): others are served, and every queue is bounded.

The deadlines are short here, so that the tests need not wait.
"""

import asyncio
import contextlib
import socket
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

import pytest

from grants.model import Right
from rossec.errors import ChannelError, RossecError
from rossec.master.operation.config import MasterLimits
from rossec.net.aio import SecureStream, WireProtocol, serve
from rossec.net.rpc.calls import RpcClient
from rossec.ros import xmlrpc
from rossec.ros.xmlrpc import Fault
from tests.support.attacker import EVE, HOST, credentials, dial
from tests.support.caller import caller
from tests.support.contexts import unlimited
from tests.support.site import Site
from tests.support.witness import until

T = "std_msgs/String"
LIMITS = MasterLimits(
    body=64 * 1024, connections_per_identity=4, handshake_seconds=1, request_seconds=1, idle_seconds=2
)
HEAD = b"POST / HTTP/1.1\r\nHost: x\r\nContent-Length: %d\r\n\r\n"


@pytest.fixture
async def narrow(tmp_path: Path) -> AsyncIterator[Site]:
    """A site whose master has short deadlines."""
    site = Site(tmp_path / "narrow")
    site.limits = LIMITS
    async with site.running():
        yield site


def connections(site: Site) -> int:
    assert site.master is not None
    assert site.master._server is not None
    return site.master._server.connections


def port(site: Site) -> int:
    assert site.master is not None
    return site.master.port


async def raw(site: Site, data: bytes) -> bytes:
    """Send `data` inside the channel; everything that comes until the master closes."""
    assert site.master is not None
    stream = await dial(site.master.uri, credentials(site))
    heard = b""
    try:
        await stream.send(data)
        async with asyncio.timeout(20):
            while True:
                heard += await stream.receive()
    except ChannelError:
        return heard
    finally:
        stream.abort("enough")


def close_wait(number: int) -> list[str]:
    """The sockets of a port whose peer has gone, by the kernel's table."""
    rows = [line.split() for line in Path("/proc/net/tcp").read_text().splitlines()[1:]]
    return [row[2] for row in rows if row[1].endswith(f":{number:04X}") and row[3] == "08"]


# --- M9


@pytest.mark.attack("master-load")
async def test_m9_dead_and_slow_nodes_delay_no_other(site: Site) -> None:
    """Ports that accept and never answer, closed ports, and one that never reads."""
    async with contextlib.AsyncExitStack() as stack:
        silent = stack.enter_context(socket.create_server((HOST, 0), backlog=64))
        for number in range(50):
            where = silent.getsockname()[1] if number % 2 else 9
            dead = await stack.enter_async_context(caller(site, f"/dead{number}", {"/t": Right.SUBSCRIBE}))
            uri = f"http://127.1.1.{number + 1}:{where}/"
            assert (await dead("registerSubscriber", "/t", T, uri))[0] == 1
        slow = await stack.enter_async_context(caller(site, "/slow", {"/t": Right.SUBSCRIBE}))
        never = asyncio.Event()

        async def stall(*_: object) -> object:
            await never.wait()
            return [1, "", 0]

        slow.dispatch = stall  # type: ignore[method-assign,assignment]
        await slow("registerSubscriber", "/t", T, slow.uri)
        rights = {"/t": Right.SUBSCRIBE | Right.PUBLISH}
        live = await stack.enter_async_context(caller(site, "/live", rights))
        talker = await stack.enter_async_context(caller(site, "/talker", rights))
        await live("registerSubscriber", "/t", T, live.uri)
        for _ in range(20):
            live.told.clear()
            await talker("registerPublisher", "/t", T, talker.uri)
            await until(lambda: ("publisherUpdate", "/t", [talker.uri]) in live.told)
            await talker("unregisterPublisher", "/t", talker.uri)
            await until(lambda: ("publisherUpdate", "/t", []) in live.told)
        assert site.master is not None
        for client, _ in site.master.effects.updates._clients.values():
            assert len(client._pending) <= 2, "not coalesced"


@pytest.mark.attack("master-load")
async def test_m9_what_a_node_answers_is_bounded(site: Site, caplog: pytest.LogCaptureFixture) -> None:
    """The master is told to call, and is answered with 32 MiB in one unit."""
    caplog.set_level("INFO")
    given_up = asyncio.Event()

    async def flood(stream: SecureStream[Any]) -> None:
        await stream.receive()
        with contextlib.suppress(ChannelError):
            await stream.send(b"HTTP/1.1 200 OK\r\n", b"x" * (32 << 20))
        given_up.set()

    home = site.enroll(EVE)
    async with (
        serve(flood, HOST, 0, unlimited(home.credentials(), site.anchor.verify), WireProtocol.HTTP) as server,
        caller(site, EVE, {"/t": Right.SUBSCRIBE | Right.PUBLISH}) as eve,
    ):
        uri = f"http://{HOST}:{server.port}/"
        await eve("registerSubscriber", "/t", T, uri)
        await eve("registerPublisher", "/t", T, uri)
        await asyncio.wait_for(given_up.wait(), 20)
        await until(lambda: "sends a unit of more than" in caplog.text)


# --- M10


@pytest.mark.attack("master-load")
@pytest.mark.parametrize(
    ("data", "status"),
    [
        (HEAD % (1 << 40), b"413"),
        (b"POST / HTTP/1.1\r\nHost: x\r\nA: " + b"a" * 9000, b"431"),
        (b"POST / HTTP/1.1\r\nHost: x\r\nTransfer-Encoding: chunked\r\n\r\n", b"411"),
        (b"GET / HTTP/1.1\r\nHost: x\r\n\r\n", b"405"),
        (b"\x16\x03\x01", b"400"),
        (HEAD % 5 + b"hello" + b"POST / HTTP/1.1\r\nContent-Length: 1\r\n\r\nx", b"400"),
    ],
)
async def test_m10_http_is_bounded(narrow: Site, data: bytes, status: bytes) -> None:
    heard = await raw(narrow, data)
    assert heard.split(b"HTTP/1.1 ")[-1].startswith(status)
    assert b"Connection: close" in heard


def nested(depth: int) -> bytes:
    value = b"<value><array><data>" * depth + b"</data></array></value>" * depth
    params = b"<params><param>%s</param></params>" % value
    return b"<methodCall><methodName>getPid</methodName>%s</methodCall>" % params


BOMB = (
    b'<?xml version="1.0"?><!DOCTYPE m [<!ENTITY a "aaaaaaaaaa"><!ENTITY b "&a;&a;&a;&a;&a;">]>'
    b"<methodCall><methodName>getPid</methodName><params><param><value>&b;</value></param></params>"
    b"</methodCall>"
)


@pytest.mark.attack("master-load")
@pytest.mark.parametrize(
    ("body", "said"),
    [
        (BOMB, b"document type"),
        (b"<!DOCTYPE m SYSTEM 'http://127.0.0.1:9/'><methodCall/>", b"document type"),
        (nested(1000), b"deeper"),
        (nested(1200)[:-1], b"deeper"),
        (b"<methodCall>" * 2000, b"deeper"),
        (xmlrpc.dump_call("m" * 5000, ()), b"too long"),
        (xmlrpc.dump_call("a", ()).decode().encode("utf-16"), b"malformed"),
    ],
)
async def test_m10_xml_is_bounded(narrow: Site, body: bytes, said: bytes) -> None:
    async with caller(narrow, "/other") as other:
        request = HEAD % len(body) + body
        heard = await raw(narrow, request.replace(b"Host: x", b"Host: x\r\nConnection: close"))
        assert said in heard
        assert (await other("getPid"))[0] == 1


@pytest.mark.attack("master-load")
async def test_m10_calls_in_a_multicall_are_authorized(site: Site) -> None:
    async with caller(site, EVE, {"/p": Right.PARAM_SET}) as eve:

        async def multicall(*calls: tuple[object, ...]) -> Any:
            elements = [{"methodName": name, "params": list(params)} for name, *params in calls]
            return await eve.client.call("system.multicall", elements)

        answers = await multicall(
            ("setParam", EVE, "/p", 1),
            ("setParam", EVE, "/q", 1),
            ("setParam", "/robot", "/p", 1),
            ("shutdown", EVE, "x"),
            ("system.multicall", []),
            ("nonsense",),
        )
        assert [answer[0][0] if isinstance(answer, list) else "fault" for answer in answers] == [
            1,
            -1,
            -1,
            -1,
            "fault",
            "fault",
        ]
        with pytest.raises(Fault, match="at most"):
            await multicall(*[("getPid", EVE)] * 4097)
        with pytest.raises(Fault, match="state queries"):
            await multicall(*[("getSystemState", EVE)] * 17)
        host = f"http://{'x' * 5000}:1/"
        assert (await eve("registerSubscriber", "/p", T, host))[0] == -1


@pytest.mark.attack("master-load")
async def test_m10_unsendable_values_are_refused(site: Site) -> None:
    """A value of XML-RPC's extensions that no answer can carry is refused."""
    assert site.master is not None
    values = (
        "<int>99999999999</int>",
        "<i8>99999999999</i8>",
        "<struct><member><name>x</name><value><nil/></value></member></struct>",
        "<array><data><value><bigdecimal>1.5</bigdecimal></value></data></array>",
    )
    async with caller(site, EVE, {"/p": Right.PARAM_SET | Right.PARAM_GET}) as eve:
        await eve("setParam", "/p/good", 1)
        for value in values:
            params = (f"<param><value>{each}</value></param>" for each in (EVE, "/p", value))
            inner = f"<methodName>setParam</methodName><params>{''.join(params)}</params>"
            body = f"<methodCall>{inner}</methodCall>".encode()
            request = (HEAD % len(body)).replace(b"Host: x", b"Host: x\r\nConnection: close")
            heard = await raw(site, request + body)
            assert b"XML-RPC cannot carry" in heard
        assert await eve("getParam", "/p") == [1, "Parameter [/p]", {"good": 1}]


@pytest.mark.attack("master-load")
async def test_m10_the_answer_of_a_multicall_is_bounded(site: Site) -> None:
    """A thousand short calls for one long parameter: a gigabyte, if they were answered."""
    async with (
        caller(site, EVE, {"/p": Right.PARAM_SET | Right.PARAM_GET}) as eve,
        caller(site, "/other") as other,
    ):
        await eve("setParam", "/p", "x" * 900_000)
        calls = [{"methodName": "getParam", "params": [EVE, "/p"]}] * 1000
        with pytest.raises(Fault, match="2 of its 1000 calls were made"):
            await eve.client.call("system.multicall", calls)
        for number in range(5):
            await eve("setParam", f"/p/n{number}", "x" * 900_000)
        with pytest.raises(Fault, match="ask for less at a time"):
            await eve("getParam", "/p")
        assert (await eve("hasParam", "/p"))[0] == 1  # over the same connection
        assert (await other("getPid"))[0] == 1


# --- M11


@pytest.mark.attack("half-open")
async def test_m11_slow_connections_time_out(narrow: Site) -> None:
    """Silent, byte by byte in clear, half a call in the channel, and idle after a call."""
    loop = asyncio.get_running_loop()

    async def silent(first: bytes, *, drip: bool) -> None:
        with socket.socket() as sock:
            sock.setblocking(False)
            await loop.sock_connect(sock, (HOST, port(narrow)))
            with contextlib.suppress(OSError):
                for byte in first:
                    await loop.sock_sendall(sock, bytes([byte]))
                    await asyncio.sleep(0.3 if drip else 0)
                while await loop.sock_recv(sock, 4096):
                    pass

    async def half(data: bytes) -> None:
        await raw(narrow, data)

    async def idle() -> None:
        assert narrow.master is not None
        client = RpcClient(await dial(narrow.master.uri, credentials(narrow, "/idle")))
        assert await client.ask("getPid", "/idle")
        await client._stream.wait_ended()  # type: ignore[attr-defined]

    async with asyncio.timeout(20), asyncio.TaskGroup() as group:
        group.create_task(silent(b"", drip=False))
        group.create_task(silent(b"GET /rossec HTTP/1.1\r\nHost: rossec\r\n", drip=True))
        group.create_task(silent(HEAD, drip=True))
        group.create_task(half(HEAD[:20]))
        group.create_task(half(HEAD % 100 + b"<methodCall>"))
        group.create_task(idle())
    await until(lambda: connections(narrow) == 0)


@pytest.mark.attack("master-load")
async def test_m11_connections_are_limited_per_identity(narrow: Site) -> None:
    assert narrow.master is not None
    greedy = [RpcClient(await dial(narrow.master.uri, credentials(narrow))) for _ in range(4)]
    for client in greedy:
        assert await client.ask("getPid", EVE)
    with pytest.raises(RossecError):
        await RpcClient(await dial(narrow.master.uri, credentials(narrow))).ask("getPid", EVE)
    async with caller(narrow, "/other") as other:
        assert (await other("getPid"))[0] == 1
    for client in greedy:
        await client.close()
    await until(lambda: connections(narrow) == 0)
    again = RpcClient(await dial(narrow.master.uri, credentials(narrow)))
    assert await again.ask("getPid", EVE)
    await again.close()


@pytest.mark.attack("half-open")
async def test_m11_connections_the_peer_closed_are_released(narrow: Site) -> None:
    """No CLOSE_WAIT pile-up (ros_comm#610): before, in and after the handshake."""
    assert narrow.master is not None
    for number in range(30):
        with socket.create_connection((HOST, port(narrow))) as sock:
            sock.sendall(HEAD[: number % 5])
    for _ in range(3):
        stream = await dial(narrow.master.uri, credentials(narrow))
        stream.transport.abort()  # as if the process had died
    await until(lambda: connections(narrow) == 0)
    assert close_wait(port(narrow)) == []

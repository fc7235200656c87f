"""Plain ROS programs, plain HTTP and garbage at the ports of a secured system.

Each receives a refusal it can log, or nothing; none learns a name; meanwhile a pair of
authorized nodes loses no message.
"""

import asyncio
import contextlib
import hashlib
import http.client
import socket
import ssl
import threading
import xmlrpc.client
from collections.abc import AsyncIterator, Iterator
from pathlib import Path
from typing import Final
from xmlrpc.server import SimpleXMLRPCServer

import pytest

from rossec.channel.opening import REFUSAL, WireProtocol, first_bytes, http_refusal, tcpros_refusal
from rossec.net.limits import HalfOpenLimits
from rossec.ros import tcpros
from rossec.ros.names import parse_uri
from tests.support import stock
from tests.support.site import Site
from tests.support.witness import POSE, TOPIC, Witness, undisturbed, until

HOST: Final = "127.0.0.1"
QUIET: Final = 5.0  # seconds: an answer arrives within this time
PRIVATE: Final = (b"robot", b"viewer", b"pose", b"geometry", b"home", b"md5sum")


@pytest.fixture
async def site(tmp_path: Path) -> AsyncIterator[Site]:
    async with Site(tmp_path / "site").running() as site:
        yield site


@pytest.fixture
async def witness(site: Site) -> AsyncIterator[Witness]:
    async with undisturbed(site) as witness:
        yield witness


def open_ports(site: Site, witness: Witness) -> dict[str, int]:
    """Every port that a network scan finds."""
    assert site.master is not None
    return {
        "master": site.master.port,
        "robot's API": parse_uri(witness.robot.uri)[1],
        "robot's topics": witness.topic_port,
        "viewer's API": parse_uri(witness.viewer.uri)[1],
        "viewer's topics": witness.viewer.topic_endpoint()[1],
    }


# --- stock ROS


@contextlib.contextmanager
def false_slave(topic_port: int) -> Iterator[str]:
    """A plain slave API that directs subscribers to `topic_port`; its URI."""
    with SimpleXMLRPCServer((HOST, 0), logRequests=False) as server:
        answer = [1, "ready", ["TCPROS", HOST, topic_port]]
        server.register_function(lambda *_: answer, "requestTopic")
        thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.05})
        thread.start()
        try:
            yield f"http://{HOST}:{server.server_address[1]}/"
        finally:
            server.shutdown()
            thread.join()


@pytest.mark.ros
async def test_a_stock_subscriber_logs_why_it_is_refused(witness: Witness, tmp_path: Path) -> None:
    async with stock.rosmaster(tmp_path) as uri:
        with false_slave(witness.topic_port) as slave:
            with xmlrpc.client.ServerProxy(uri) as master:
                await asyncio.to_thread(master.registerPublisher, "/false", TOPIC, POSE, slave)
            env = stock.environment(uri, tmp_path)
            command = stock.python(stock.LISTENER, TOPIC)
            async with stock.process(env, *command) as listener:
                line = await stock.logged(tmp_path, "rossec: ")
                assert "remote error reported: " + REFUSAL in line
                await witness.goes_on()
                listener.terminate()
                said, _ = await listener.communicate()
                assert b"RECEIVED" not in said


@pytest.mark.ros
@pytest.mark.parametrize(
    "command", [("rostopic", "list"), ("rostopic", "echo", TOPIC), ("rosnode", "list")], ids=" ".join
)
async def test_the_stock_tools_print_why_they_are_refused(
    site: Site, witness: Witness, tmp_path: Path, command: tuple[str, ...]
) -> None:
    assert site.master is not None
    env = stock.environment(site.master.uri, tmp_path)
    code, said = await stock.run(env, str(stock.TOOLS / command[0]), *command[1:])
    assert code != 0
    assert said == f"ERROR: {REFUSAL}\n"


@pytest.mark.ros
async def test_a_stock_node_logs_why_it_cannot_register(site: Site, witness: Witness, tmp_path: Path) -> None:
    assert site.master is not None
    env = stock.environment(site.master.uri, tmp_path)
    _, said = await stock.run(env, *stock.python(stock.NODE))
    assert f"unable to register publication [/stock] with master: {REFUSAL}" in said
    assert "Traceback" not in said
    state = await witness.robot._membership.session.call("getSystemState")
    assert "stock" not in str(state)


# --- plain HTTP


@pytest.mark.parametrize("index", range(5))
async def test_plain_http_gets_only_the_refusal(site: Site, witness: Witness, index: int) -> None:
    port = list(open_ports(site, witness).values())[index]
    calls = ("getSystemState", "getPublications", "requestTopic", "shutdown", "system.multicall")
    for method in calls:
        body = xmlrpc.client.dumps(("/viewer", TOPIC, [["TCPROS"]]), method)
        status, data = await asyncio.to_thread(http_exchange, port, "POST", body)
        assert (status, data) == (200, http_refusal(REFUSAL).partition(b"\r\n\r\n")[2])
        assert xmlrpc.client.loads(data) == (([-1, REFUSAL, 0],), None)
    for method in ("GET", "HEAD", "PUT", "OPTIONS"):
        raw = await asyncio.to_thread(exchange, port, f"{method} / HTTP/1.1\r\nHost: x\r\n\r\n".encode())
        assert raw == http_refusal(REFUSAL)


def http_exchange(port: int, method: str, body: str) -> tuple[int, bytes]:
    connection = http.client.HTTPConnection(HOST, port, timeout=QUIET)
    with contextlib.closing(connection):
        connection.request(method, "/RPC2", body, {"Content-Type": "text/xml"})
        answer = connection.getresponse()
        return answer.status, answer.read()


# --- garbage


def exchange(port: int, data: bytes) -> bytes:
    """Send `data` and shut down the sending side; return everything received."""
    heard = b""
    with socket.create_connection((HOST, port), timeout=QUIET) as connection:
        with contextlib.suppress(ConnectionError):
            connection.sendall(data)
            connection.shutdown(socket.SHUT_WR)
        with contextlib.suppress(ConnectionError):
            while part := connection.recv(65536):
                heard += part
    return heard


def client_hello() -> bytes:
    """The first message of an HTTPS client."""
    incoming, outgoing = ssl.MemoryBIO(), ssl.MemoryBIO()
    context = ssl.create_default_context()
    client = context.wrap_bio(incoming, outgoing, server_hostname="robot")
    with contextlib.suppress(ssl.SSLWantReadError):
        client.do_handshake()
    return outgoing.read()


def noise(seed: int, length: int) -> bytes:
    return hashlib.shake_256(bytes([seed])).digest(length)


TCPROS_OPENING: Final = first_bytes(WireProtocol.TCPROS)
HTTP_OPENING: Final = first_bytes(WireProtocol.HTTP)
PLAIN_HEADER: Final = tcpros.encode({"callerid": "/viewer", "topic": TOPIC, "md5sum": "*", "type": "*"})
GARBAGE: Final[dict[str, bytes]] = {
    **{f"noise {seed}": noise(seed, 40 << seed) for seed in range(8)},
    "nothing": b"",
    "one byte": b"\0",
    "zeros": bytes(70_000),
    "TLS": client_hello(),
    "SSH": b"SSH-2.0-OpenSSH_9.2\r\n",
    "a gigabyte announced": (10**9).to_bytes(4, "little"),
    "four gigabytes announced": b"\xff" * 64,
    "HTTP without an end": b"GET / HTTP/1.1\r\nX: " + b"a" * 5000,
    "HTTP with a huge body": b"POST / HTTP/1.1\r\nContent-Length: 999999999999\r\n\r\n",
    "HTTP with chunks": b"POST / HTTP/1.1\r\nTransfer-Encoding: chunked\r\n\r\nffffffff\r\n",
    "a plain header": PLAIN_HEADER,
    "a probe": tcpros.encode({"probe": "1", "service": "/x", "md5sum": "*", "callerid": "/x"}),
    "an opening alone": TCPROS_OPENING,
    "an opening and noise": TCPROS_OPENING + noise(9, 3000),
    "an opening and a plain header": TCPROS_OPENING + PLAIN_HEADER,
    "an opening twice": TCPROS_OPENING * 2,
    "another version": TCPROS_OPENING.replace(b"rossec=1", b"rossec=2"),
    "an upgrade and noise": HTTP_OPENING + noise(10, 3000),
    "an upgrade and a call": HTTP_OPENING + xmlrpc.client.dumps((), "getPid").encode(),
}


async def test_invalid_bytes_get_no_useful_answer(site: Site, witness: Witness) -> None:
    for data in GARBAGE.values():
        for port in open_ports(site, witness).values():
            heard = await asyncio.to_thread(exchange, port, data)
            assert harmless(heard), (data[:40], heard)
    await witness.goes_on()


def harmless(heard: bytes) -> bool:
    """Empty, one of the refusals, or a short handshake error without names."""
    for known in (http_refusal(REFUSAL), tcpros_refusal(REFUSAL)):
        heard = heard.removeprefix(known)
    switch = b"HTTP/1.1 101 Switching Protocols\r\nConnection: Upgrade\r\nUpgrade: rossec/1\r\n\r\n"
    rest = heard.removeprefix(switch)
    return len(rest) < 100 and not any(word in rest for word in PRIVATE)


async def test_slow_and_silent_peers_delay_no_other_peer(site: Site, witness: Witness) -> None:
    """A byte at a time, or none, at every port, while messages and new connections get through."""
    loop = asyncio.get_running_loop()
    async with contextlib.AsyncExitStack() as stack:
        slow = []
        for port in open_ports(site, witness).values():
            for data in (b"", TCPROS_OPENING, HTTP_OPENING, PLAIN_HEADER, client_hello()):
                connection = socket.create_connection((HOST, port))
                stack.callback(connection.close)
                connection.setblocking(False)
                slow.append((connection, data))
        for position in range(20):
            for connection, data in slow:
                with contextlib.suppress(ConnectionError):
                    await loop.sock_sendall(connection, data[position : position + 1])
            await witness.goes_on(2)
        await newcomer(site, "/late")


async def test_a_flood_of_half_open_connections_leaves_none(site: Site, witness: Witness) -> None:
    """N8: more half-open connections than allowed per address; open ones are not affected."""
    count = 2 * HalfOpenLimits().per_address
    with contextlib.ExitStack() as stack:
        for _ in range(count):
            where = HOST, witness.topic_port
            connection = await asyncio.to_thread(socket.create_connection, where, QUIET)
            stack.callback(connection.close)
        await witness.goes_on()
    await newcomer(site, "/after")


async def newcomer(site: Site, name: str) -> None:
    """An authorized node that connects now receives its messages."""
    site.subscribe(name, TOPIC)
    async with site.node(name) as node:
        subscriber = await node.subscriber(TOPIC, POSE)
        await until(lambda: subscriber.received > 0)

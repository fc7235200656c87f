"""The TCPROS port of a secured rospy node: unauthorized connections (N5-N9, D2)."""

import asyncio
import contextlib
import socket
import time
from collections.abc import AsyncIterator, Callable
from pathlib import Path
from typing import Any, Final

import pytest
import pytest_asyncio

from ca.certificates import Identity
from ca.encoding import encode
from grants.model import Right
from rossec.channel.opening import REFUSAL, tcpros_refusal
from rossec.demo.intruder import accept_any
from rossec.errors import ChannelError
from rossec.inprocess.process import PEER_CONNECTIONS
from rossec.net.aio import SecureStream, WireProtocol, connect, serve
from rossec.net.limits import HalfOpenLimits
from rossec.net.rpc.calls import serve_calls
from rossec.participant.access import FIELD
from rossec.participant.message_types import message_type
from rossec.ros import tcpros
from tests.support.attacker import (
    EVE,
    HOST,
    Reply,
    call,
    credentials,
    dial,
    expect_no_room,
    fields_for,
    send_header,
)
from tests.support.contexts import unlimited
from tests.support.victim import COMMAND, SERVICE, STATE, TYPE, Victim, attacked, for_service, slave_port
from tests.support.witness import until

pytestmark = [pytest.mark.ros, pytest.mark.asyncio(loop_scope="module")]
NOWHERE: Final = "/robot/none"


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def victim(tmp_path_factory: pytest.TempPathFactory) -> AsyncIterator[Victim]:
    directory: Path = tmp_path_factory.mktemp("victim")
    async with attacked(directory) as victim:
        yield victim


async def heard(victim: Victim, fields: dict[str, Any], name: str = EVE) -> Reply:
    """The answer to a header; others are not disturbed."""
    answer = await send_header(victim.port, credentials(victim.site, name), fields)
    await victim.goes_on(3)
    return answer


def expect_refusal(answer: Reply, *words: str) -> None:
    assert set(answer.fields) == {"error"}
    assert answer.error.startswith("rossec: ")
    assert answer.after == b"", "not a byte of data"
    assert all(word in answer.error for word in words), answer.error


@pytest.mark.attack("no-grant")
@pytest.mark.parametrize("grants", [None, [], [b"nonsense"]], ids=["none", "empty", "nonsense"])
async def test_without_a_grant_no_data_is_sent(victim: Victim, grants: list[bytes] | None) -> None:
    """N5."""
    expect_refusal(await heard(victim, fields_for(EVE, STATE, grants)))


@pytest.mark.attack("unit-before-right")
async def test_units_before_authorization_are_limited_to_a_header(victim: Victim) -> None:
    """A unit is buffered before it is checked."""
    own, verify = credentials(victim.site), victim.site.anchor.verify
    await expect_no_room(await connect(HOST, victim.port, unlimited(own, verify)), 300_000)
    await expect_no_room(await dial(victim.uri, own), 3 * 1024 * 1024)
    await victim.goes_on()


@pytest.mark.attack("existence-oracle")
@pytest.mark.parametrize("changes", [{}, {"md5sum": "0" * 32}, {"probe": "1"}])
async def test_refusals_do_not_tell_what_exists(victim: Victim, changes: dict[str, str]) -> None:
    """N6: the refusal does not tell whether a topic, service or type exists."""
    for names, make in (((STATE, NOWHERE), fields_for), ((SERVICE, NOWHERE), for_service)):
        texts = set()
        for name in names:
            answer = await heard(victim, make(EVE, name, [], **changes))
            expect_refusal(answer)
            texts.add(answer.error.replace(name, "NAME"))
        assert len(texts) == 1
        assert not any(word in str(texts) for word in ("String", "Trigger", "command", "state"))


@pytest.mark.attack("another-name")
async def test_a_name_that_is_not_the_certified_one(victim: Victim) -> None:
    """N6: Eve shows the viewer's grants and calls herself the viewer."""
    stolen = victim.site.enroll("/viewer").grants()
    expect_refusal(await heard(victim, fields_for("/viewer", STATE, stolen)), "calls itself")
    expect_refusal(await heard(victim, fields_for(EVE, STATE, stolen)))
    expect_refusal(await heard(victim, for_service("/viewer", SERVICE, [])), "calls itself")


@pytest.mark.attack("no-grant")
async def test_a_right_covers_nothing_else(victim: Victim) -> None:
    site = victim.site
    grants = [
        site.grant("/neighbour", Right.SUBSCRIBE, COMMAND),
        site.grant("/neighbour", Right.PUBLISH, STATE),
        site.grant("/neighbour", Right.PROVIDE, SERVICE),
    ]
    answer = await heard(victim, fields_for("/neighbour", STATE, grants), "/neighbour")
    expect_refusal(answer, "no grant")
    expect_refusal(await heard(victim, for_service("/neighbour", SERVICE, grants), "/neighbour"), "no grant")


@pytest.mark.attack("unit-before-right")
async def test_a_header_without_end_uses_no_memory(victim: Victim) -> None:
    """N7: a length near a gigabyte, before the handshake and after it."""
    before = memory(victim)
    for length in (10**9, 0xFFFFFFFF):
        data = length.to_bytes(4, "little") + b"x" * 4096
        plain = await asyncio.to_thread(exchange, victim.port, data)
        assert plain in (b"", tcpros_refusal(REFUSAL)) or len(plain) < 100
        answer = await raw(victim, data)
        assert b"state" not in answer
    assert memory(victim) - before < 20_000
    await victim.goes_on()


def memory(victim: Victim) -> int:
    """Resident kilobytes of the robot."""
    status = Path(f"/proc/{victim.program.process.pid}/status").read_text()
    return int(status.partition("VmRSS:")[2].split()[0])


def exchange(port: int, data: bytes) -> bytes:
    answer = b""
    sock = socket.create_connection((HOST, port), timeout=10)
    with sock, contextlib.suppress(ConnectionError):
        sock.sendall(data)
        while part := sock.recv(4096):
            answer += part
    return answer


async def raw(victim: Victim, data: bytes) -> bytes:
    """Send `data` as Eve inside the channel; all that comes back."""
    stream = await connect(HOST, victim.port, unlimited(credentials(victim.site), accept_any))
    answer = b""
    with contextlib.suppress(ChannelError):
        await stream.send(data)
        while True:
            answer += await stream.receive()
    return answer


@pytest.mark.attack("half-open")
@pytest.mark.parametrize("port", [lambda victim: victim.port, slave_port], ids=["topics", "api"])
async def test_silent_connections_block_no_other(victim: Victim, port: Callable[[Victim], int]) -> None:
    """N8: stock rospy blocks after the first; here a new caller is served meanwhile."""
    count = 2 * HalfOpenLimits().per_address
    with contextlib.ExitStack() as stack:
        for _ in range(count):
            sock = await asyncio.to_thread(socket.create_connection, (HOST, port(victim)), 10)
            stack.callback(sock.close)
        await victim.goes_on()
    grant = victim.site.subscribe("/after", STATE)
    end = time.monotonic() + 20
    while True:  # slots are released as the sockets are found closed
        with contextlib.suppress(ChannelError):
            answer = await admitted(victim, "/after", grant)
            assert b"std_msgs/String" in answer
            break
        assert time.monotonic() < end
    await victim.goes_on()


async def admitted(victim: Victim, name: str, *grants: bytes) -> bytes:
    """The header with which a subscriber is admitted, and what followed it at once."""
    fields = fields_for(name, STATE, list(grants))
    answer = await send_header(victim.port, credentials(victim.site, name), fields, at_most=2000)
    assert "error" not in answer.fields, answer.fields
    return b"".join(answer.fields.values())


# --- N9: another node at the publisher's address


@pytest.mark.attack("false-publisher")
async def test_a_false_publisher_is_refused(victim: Victim) -> None:
    """Eve answers at an honest publisher's address, with its grants and its name."""
    site = victim.site
    grants = [site.publish("/commander", COMMAND)]
    names = ["/commander", EVE]
    kind = message_type(TYPE)

    async def talk(stream: SecureStream[Identity]) -> None:
        await stream.receive()
        fields: dict[str, str | bytes] = {
            "callerid": names[0],
            "topic": COMMAND,
            "type": kind.name,
            "md5sum": kind.md5sum,
            "message_definition": kind.definition,
            FIELD: encode(list(grants)),
        }
        names.reverse()
        data = bytes(kind.serialize(kind.create(data="obey me")))
        with contextlib.suppress(ChannelError):
            await stream.send(tcpros.encode(fields), tcpros.frame(data) * 5)
            await stream.receive()

    async def answer_calls(stream: SecureStream[Identity]) -> None:
        async def dispatch(method: str, params: tuple[object, ...], peer: object) -> object:
            return [1, "", ["TCPROS", HOST, topics.port]]

        await serve_calls(stream, dispatch)

    commander, anchor = credentials(site, "/commander"), site.anchor
    topics = serve(talk, HOST, 0, unlimited(credentials(site), anchor.verify))
    api = serve(answer_calls, HOST, 0, unlimited(commander, anchor.verify), WireProtocol.HTTP)
    try:
        assert site.master is not None
        master = site.master.uri
        await call(master, commander, "rossec.presentGrants", "/commander", grants)
        params = ("/commander", COMMAND, TYPE, f"http://{HOST}:{api.port}/")
        assert await call(master, commander, "registerPublisher", *params)
        for said in ("a node certified as /eve calls itself /commander", "another key"):
            await until(lambda said=said: said in victim.said, within=20)  # type: ignore[misc]
        await victim.goes_on()
    finally:
        await topics.close()
        await api.close()


# --- D2: rights that end while the connection lives


@pytest.mark.attack("outlived-right")
@pytest.mark.parametrize("what", ["grant", "key"])
async def test_a_revocation_closes_only_its_connection(victim: Victim, what: str) -> None:
    site, name = victim.site, f"/visitor_{what}"
    grant = site.subscribe(name, STATE)
    async with site.node(name) as visitor:
        sight = await visitor.subscriber(STATE, TYPE)
        await until(lambda: sight.received > 0, within=20)
        data = site.revoke(grant if what == "grant" else site.identity(name).thumbprint)
        await victim.viewer._membership.session.call("rossec.updateRevocations", data)
        await until(lambda: f"closed the connection with {name}" in victim.said, within=20)
        await until(lambda: not sight.links, within=20)
        received = sight.received
        await victim.goes_on()
        assert sight.received == received


@pytest.mark.attack("outlived-right")
async def test_a_connection_is_closed_when_its_grant_expires(victim: Victim) -> None:
    site = victim.site
    site.subscribe("/guest", STATE, lifetime=4)
    async with site.node("/guest") as guest:
        sight = await guest.subscriber(STATE, TYPE)
        await until(lambda: sight.received > 0, within=20)
        await until(lambda: "closed the connection with /guest" in victim.said, within=20)
        await until(lambda: not sight.links, within=20)
        await victim.goes_on()


@pytest.mark.attack("node-load")
async def test_connections_are_limited_per_identity(victim: Victim) -> None:
    """N8: also with the right; others are served, and revoking its key closes all of them (D2)."""
    site, name = victim.site, "/many"
    grants = [site.grant(name, Right.CALL, SERVICE)]
    own = credentials(site, name)
    fields = for_service(name, SERVICE, grants, persistent="1")
    streams = []
    for _ in range(PEER_CONNECTIONS):
        streams.append(await connect(HOST, victim.port, unlimited(own, site.anchor.verify)))
        await streams[-1].send(tcpros.encode(fields))
        assert b"callerid=/robot" in await streams[-1].receive()
    expect_refusal(await heard(victim, fields, name), "has 64 connections already")
    data = site.revoke(site.identity(name).thumbprint)
    await victim.viewer._membership.session.call("rossec.updateRevocations", data)
    async with asyncio.timeout(20):
        for stream in streams:
            await stream.wait_ended()
    await victim.goes_on()

"""Attacks on the compact form of calls, by enrolled peers: only they are inside the channel."""

import asyncio
import contextlib
from collections.abc import AsyncIterator
from typing import Any

import pytest

from grants.model import Right
from rossec.errors import ChannelError, CompactRefused, HttpRefused, RossecError
from rossec.net.aio import SecureStream, WireProtocol, serve
from rossec.net.limits import UNSHOWN_BODY, UNSHOWN_UNIT
from rossec.net.rpc.calls import RpcClient
from rossec.ros import calls
from rossec.ros.calls import CallClient, CallServer, value_in
from rossec.ros.compact_values import encoded
from rossec.ros.xmlrpc import BODY_LIMIT, Fault
from tests.rossec.ros.test_compactread import REFUSED
from tests.support.attacker import EVE, HOST, credentials, dial
from tests.support.caller import caller, refusal
from tests.support.contexts import unlimited
from tests.support.site import Site
from tests.support.witness import TOPIC, Witness

GET_PID = "getPid"


def master(site: Site) -> str:
    assert site.master is not None
    return site.master.uri


@contextlib.asynccontextmanager
async def switched(site: Site, uri: str) -> AsyncIterator[tuple[SecureStream[Any], CallClient]]:
    """A connection of /eve on which units are exchanged, after one honest call."""
    stream, client = await dial(uri, credentials(site)), CallClient("x")
    try:
        await stream.send(client.request(GET_PID, (EVE,)))
        value_in(client.take(await stream.receive()))
        assert client.is_compact
        yield stream, client
    finally:
        stream.abort("enough")


async def hung_up(stream: SecureStream[Any]) -> None:
    """The peer ends the connection, and answers nothing."""
    with pytest.raises(ChannelError):
        async with asyncio.timeout(30):
            await stream.receive()


async def still_served(site: Site, uri: str) -> None:
    """Others, and /eve itself on a new connection, are answered."""
    async with switched(site, uri) as (stream, client):
        await stream.send(client.request(GET_PID, (EVE,)))
        async with asyncio.timeout(30):
            assert client.take(await stream.receive())


def unit(item: bytes) -> bytes:
    """A call of `setParam` in its turn, with this for a value."""
    return bytes.fromhex("86185201") + b"\x01" + encoded(EVE) + encoded("/p") + item


NO_UNITS = {
    **{name: unit(bytes.fromhex(written)) for name, written in REFUSED.items()},
    "a member within a member": unit(b"\xa1\x61a\xa2\x61a\x01\x61a\x01"),
    "arrays in arrays": unit(b"\x81" * 41 + b"\x01"),
    "a hundred thousand arrays": unit(b"\x81" * 100_000 + b"\x01"),
    "maps in maps": unit(b"\xa1\x61a" * 41 + b"\x01"),
    "a million empty arrays": unit(bytes.fromhex("9a000f4240") + b"\x80" * 1_000_000),
    "a million empty texts as names": unit(bytes.fromhex("ba000f4240") + b"\x60\x00" * 500_000),
    "a count without an end": unit(bytes.fromhex("9affffffff")),
    "a length without an end": unit(bytes.fromhex("7affffffff")),
    "more than a body": unit(encoded("x" * BODY_LIMIT)),
    "no method": bytes.fromhex("82185201"),
    "an unknown number": bytes.fromhex("83185201183d"),
    "the number of another method in two bytes": bytes.fromhex("831852011800"),
    "a name that has a number": bytes.fromhex("83185201") + encoded("getParam"),
    "a method that is a list": bytes.fromhex("8318520180"),
    "another mark": bytes.fromhex("831853011600"),
    "an answer": calls.dump_compact_answer(1, [1, "", 0]),
    "two calls": unit(b"\x01") * 2,
    "a request of HTTP": CallClient("x").request(GET_PID, (EVE,)),
    "the rest of a request": b"\r\n",
}


async def is_refused(site: Site, uri: str, name: str) -> None:
    """The connection on which this is sent ends, and nothing is answered.

    But what is too long for a caller without a grant: that is answered so, unread.
    """
    async with switched(site, uri) as (stream, _):
        with contextlib.suppress(ChannelError):  # it may be closed before all is sent
            await stream.send(NO_UNITS[name])
        try:
            if UNSHOWN_BODY < len(NO_UNITS[name]) <= UNSHOWN_UNIT:
                assert b"that has shown no grant" in await stream.receive()
                return
            await hung_up(stream)
        except (pytest.fail.Exception, TimeoutError) as error:
            raise AssertionError(name) from error


@pytest.mark.attack("compact-unit")
async def test_what_is_no_unit_ends_the_connection(site: Site) -> None:
    """Nothing of it is called, and no answer tells how far it was read."""
    assert len(NO_UNITS) > 60
    for name in NO_UNITS:
        await is_refused(site, master(site), name)
    await still_served(site, master(site))


@pytest.mark.attack("compact-unit")
async def test_nodes_read_as_strictly(site: Site, witness: Witness) -> None:
    for name in ("a bignum", "two calls", "a million empty arrays", "null", "a request of HTTP"):
        await is_refused(site, witness.robot.uri, name)
    await still_served(site, witness.robot.uri)


@pytest.mark.attack("compact-unit")
async def test_a_parameter_cannot_be_set_that_xml_rpc_cannot_read(site: Site) -> None:
    """Else one node would make a tree unreadable for all that have the other form only."""
    for item in ("6100", "611f", "63efbfbe", "f6", "1a80000000"):
        async with switched(site, master(site)) as (stream, _):
            await stream.send(unit(bytes.fromhex(item)))
            await hung_up(stream)
    async with caller(site, EVE, {"/p": Right.PARAM_GET}) as eve:
        assert (await eve("getParam", "/p"))[0] == -1


@pytest.mark.attack("compact-turns")
async def test_a_call_out_of_its_turn_ends_the_connection(site: Site) -> None:
    for turn in (0, 2, 3, 23):
        async with switched(site, master(site)) as (stream, _):
            await stream.send(calls.dump_compact_call(turn, GET_PID, (EVE,)))
            await hung_up(stream)


@pytest.mark.attack("compact-turns")
async def test_a_number_is_used_once(site: Site) -> None:
    async with switched(site, master(site)) as (stream, client):
        again = client.request(GET_PID, (EVE,))
        await stream.send(again)
        assert client.take(await stream.receive())
        await stream.send(again)
        await hung_up(stream)


@pytest.mark.attack("compact-turns")
async def test_calls_while_one_is_answered_end_the_connection_and_that_call(site: Site) -> None:
    """A watch takes five seconds; what comes meanwhile is not queued."""
    async with switched(site, master(site)) as (stream, client):
        await stream.send(client.request("rossec.watchGrants", (EVE, b"")))
        for turn in range(2, 20):
            with contextlib.suppress(ChannelError):
                await stream.send(calls.dump_compact_call(turn, GET_PID, (EVE,)))
        await hung_up(stream)
    await still_served(site, master(site))


@pytest.mark.attack("compact-turns")
@pytest.mark.parametrize(
    "lie", ["an old answer", "a later answer", "two answers", "HTTP", "a call", "a body", "nothing asked"]
)
async def test_a_peer_that_answers_out_of_turn_is_left(site: Site, lie: str) -> None:
    """No answer is ever taken for that to another call."""
    good = [1, "", 7]
    lies = {
        "an old answer": calls.dump_compact_answer(0, good),
        "a later answer": calls.dump_compact_answer(2, good),
        "two answers": calls.dump_compact_answer(1, good) + calls.dump_compact_answer(2, good),
        "HTTP": b"HTTP/1.1 200 OK\r\nContent-Length: 0\r\n\r\n",
        "a call": calls.dump_compact_call(1, GET_PID, ()),
        "a body": bytes.fromhex("8301f64101"),
        "nothing asked": calls.dump_compact_answer(1, good),
    }

    async def answer(stream: SecureStream[Any]) -> None:
        server = CallServer()
        server.take(await stream.receive())
        await stream.send(server.respond(good))
        if lie != "nothing asked":
            await stream.receive()
        await stream.send(lies[lie])
        if lie == "nothing asked":
            await stream.receive()
            await stream.send(lies[lie])

    own = unlimited(credentials(site), site.anchor.verify)
    server = serve(answer, HOST, 0, own, WireProtocol.HTTP)
    try:
        client = RpcClient(await dial(f"http://{HOST}:{server.port}/", credentials(site, "/viewer")))
        assert await client.ask(GET_PID, "/viewer") == 7
        if lie == "nothing asked":  # it is read as the answer to the next call, once
            assert await client.ask(GET_PID, "/viewer") == 7
        with pytest.raises((CompactRefused, HttpRefused)):
            await client.ask(GET_PID, "/viewer")
        assert client.closed
    finally:
        await server.close()


@pytest.mark.attack("compact-rights")
async def test_neither_form_has_a_right_that_the_other_has_not(site: Site, witness: Witness) -> None:
    """The table of rights is one; `tests/rossec/master/test_compact_differential.py` has all."""
    async with caller(site, EVE) as eve:
        calls: list[tuple[object, ...]] = [
            ("registerSubscriber", TOPIC, "*", eve.uri),
            ("shutdown", "now"),
            ("setParam", "/robot/rate", 1),
            ("rossec.depositGrants", [b"x"]),
        ]
        xml = RpcClient(await dial(master(site), credentials(site)), compact=False)
        for method, *params in calls:
            refused = refusal(await eve(str(method), *params))
            assert refused == refusal(await xml.call(str(method), EVE, *params))
            lied = refusal(await eve.lie(str(method), "/robot", *params))
            assert lied == refusal(await xml.call(str(method), "/robot", *params))
        assert eve.client.is_compact
        assert not xml.is_compact
        await xml.close()


@pytest.mark.attack("compact-rights")
async def test_a_node_refuses_by_number_what_it_refuses_by_name(site: Site, witness: Witness) -> None:
    forged: list[tuple[object, ...]] = [
        ("publisherUpdate", TOPIC, []),
        ("paramUpdate", "/p", 1),
        ("shutdown", "now"),
        ("rossec.revocationUpdate", b"", b""),
        ("getBusInfo",),
        ("getParam", "/p"),
    ]
    clients = [
        RpcClient(await dial(witness.robot.uri, credentials(site)), compact=compact)
        for compact in (False, True)
    ]
    for method, *params in forged:
        answers = [await client.call(str(method), EVE, *params) for client in clients]
        assert answers[0] == answers[1]
        refusal(answers[0])
    assert [client.is_compact for client in clients] == [False, True]
    for client in clients:
        await client.close()


@pytest.mark.attack("compact-downgrade")
async def test_who_does_not_offer_or_take_loses_nothing_but_speed(site: Site) -> None:
    """Only the two peers can choose: the offer is inside the channel. XML-RPC is as strict."""
    client = RpcClient(await dial(master(site), credentials(site)), compact=False)
    for _ in range(3):
        assert await client.ask(GET_PID, EVE)
    with pytest.raises(Fault):
        await client.call("nonsense", EVE)
    assert not client.is_compact
    await client.close()


@pytest.mark.attack("compact-downgrade")
@pytest.mark.parametrize(
    "answer",
    [
        b"HTTP/1.1 101 Switching Protocols\r\nConnection: Upgrade\r\nUpgrade: h2c\r\n\r\n",
        b"HTTP/1.1 101 Switching Protocols\r\n\r\n",
        b"HTTP/1.1 101 Switching Protocols\r\nUpgrade: rossec-cbor/1\r\n\r\n\x84\x00\x01\x60\x07",
        b"HTTP/1.1 101 OK\r\nConnection: Upgrade\r\nUpgrade: rossec-cbor/1\r\n\r\n",
        b"HTTP/1.1 426 Upgrade Required\r\nContent-Length: 0\r\n\r\n",
    ],
    ids=["to another protocol", "to none", "half", "without an answer", "upgrade required"],
)
async def test_a_switch_to_anything_else_is_refused(site: Site, answer: bytes) -> None:
    async def lie(stream: SecureStream[Any]) -> None:
        await stream.receive()
        await stream.send(answer)

    own = unlimited(credentials(site), site.anchor.verify)
    server = serve(lie, HOST, 0, own, WireProtocol.HTTP)
    try:
        client = RpcClient(await dial(f"http://{HOST}:{server.port}/", credentials(site, "/viewer")))
        with pytest.raises(RossecError):
            await client.ask(GET_PID, "/viewer")
        assert client.closed
    finally:
        await server.close()

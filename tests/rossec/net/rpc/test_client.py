"""Calls over a stream: both sides joined by an in-memory pair."""

import asyncio
from collections.abc import Awaitable

import pytest

from rossec.errors import (
    AnswerRefused,
    ChannelClosed,
    CompactRefused,
    HttpRefused,
    RossecError,
    XmlRpcRefused,
)
from rossec.net.limits import UNSHOWN_UNIT
from rossec.net.rpc.calls import CallFailed, RpcClient, serve_calls
from rossec.ros import xmlrpc
from rossec.ros.calls import CallServer, dump_compact_answer
from rossec.ros.xmlrpc import Fault
from tests.support.streams import MemoryStream, stream_pair


async def dispatch(method: str, params: tuple[object, ...], peer: str) -> object:
    match method:
        case "echo":
            return [1, peer, list(params)]
        case "refuse":
            return [-1, "no right", 0]
        case "hang":
            await asyncio.sleep(60)
        case "bug":
            raise ZeroDivisionError
        case "unmarshallable":
            return None
        case _:
            pass
    raise Fault(1, "not supported")


async def serving(run: Awaitable[None], server: MemoryStream, **options: float) -> None:
    task = asyncio.ensure_future(serve_calls(server, dispatch, **options))  # type: ignore[arg-type]
    try:
        await run
    finally:
        task.cancel()
        await asyncio.gather(task, return_exceptions=True)


async def test_calls_one_after_the_other_and_at_once() -> None:
    near, far = stream_pair("/node", "/master")

    async def run() -> None:
        client = RpcClient(near)
        assert await client.call("echo", "/node", 1) == [1, "/node", ["/node", 1]]
        answers = await asyncio.gather(*(client.ask("echo", n) for n in range(5)))
        assert answers == [[n] for n in range(5)]
        await client.close()

    await serving(run(), far)
    assert far.closed


async def test_refusals_faults_and_bugs_leave_the_connection_open(caplog: pytest.LogCaptureFixture) -> None:
    near, far = stream_pair("/node", "/master")

    async def run() -> None:
        client = RpcClient(near)
        with pytest.raises(AnswerRefused, match="no right"):
            await client.ask("refuse")
        with pytest.raises(Fault, match="not supported"):
            await client.call("other")
        with pytest.raises(Fault, match="internal error"):
            await client.call("bug")
        with pytest.raises(Fault, match="cannot carry"):
            await client.call("unmarshallable")
        with pytest.raises(XmlRpcRefused):
            await client.call("echo", None)
        assert await client.ask("echo") == []

    await serving(run(), far)
    assert "ZeroDivisionError" in caplog.text


async def test_a_late_answer_closes_the_connection() -> None:
    near, far = stream_pair("/node", "/master")

    async def run() -> None:
        client = RpcClient(near, deadline=0.05)
        with pytest.raises(CallFailed, match="no answer within"):
            await client.call("hang")
        assert client.closed
        with pytest.raises(CallFailed, match="connection is closed"):
            await client.call("echo")

    await serving(run(), far)


async def test_malformed_xml_is_a_fault_and_malformed_http_ends_the_connection() -> None:
    near, far = stream_pair("/node", "/master")

    async def run() -> None:
        await near.send(b"POST / HTTP/1.1\r\nHost: x\r\nContent-Length: 3\r\n\r\n<x>")
        answer = await near.receive()
        with pytest.raises(Fault, match="malformed"):
            xmlrpc.load_response(answer.partition(b"\r\n\r\n")[2])
        await near.send(b"GET / HTTP/1.1\r\nHost: x\r\n\r\n")
        assert (await near.receive()).startswith(b"HTTP/1.1 405 ")
        with pytest.raises(RossecError):
            await near.receive()

    await serving(run(), far)


async def test_a_request_that_does_not_end_is_given_up() -> None:
    near, far = stream_pair("/node", "/master")

    async def run() -> None:
        await near.send(b"POST / HTT")
        with pytest.raises(RossecError):
            await near.receive()

    await serving(run(), far, request_deadline=0.05)


async def test_a_client_closes_on_a_broken_answer() -> None:
    near, far = stream_pair("/node", "/master")

    async def run() -> None:
        client = RpcClient(near)
        asking = asyncio.ensure_future(client.call("echo"))
        await far.receive()
        await far.send(b"SSH-2.0-OpenSSH\r\n\r\n")
        with pytest.raises(HttpRefused):
            await asking
        assert client.closed

    await run()


async def test_an_idle_connection_is_closed() -> None:
    near, far = stream_pair("/node", "/master")

    async def run() -> None:
        assert await RpcClient(near).ask("echo") == []
        with pytest.raises(RossecError):
            async with asyncio.timeout(30):
                await near.receive()

    await serving(run(), far, idle_deadline=0.05)
    assert far.closed


@pytest.mark.parametrize("compact", [True, False])
async def test_both_forms_give_the_same(compact: bool) -> None:
    near, far = stream_pair("/node", "/master")

    async def run() -> None:
        client = RpcClient(near, compact=compact)
        for n in range(30):
            assert await client.call("echo", {"a": [n, 1.0, True, b"x"]}) == [
                1,
                "/node",
                [{"a": [n, 1.0, True, b"x"]}],
            ]
            assert client.is_compact == compact
        body = await client.fetch("echo", 5)
        assert xmlrpc.load_response(body) == [1, "/node", [5]]
        for error, method in ((AnswerRefused, "refuse"), (Fault, "other"), (Fault, "bug")):
            with pytest.raises(error):
                await client.ask(method)
        assert await client.ask("echo") == []

    await serving(run(), far)


async def test_a_server_that_takes_no_offers_is_called_in_xml_rpc() -> None:
    near, far = stream_pair("/node", "/master")

    async def run() -> None:
        client = RpcClient(near)
        for n in range(3):
            assert await client.ask("echo", n) == [n]
        assert not client.is_compact

    await serving(run(), far, compact=False)


async def test_a_client_closes_on_a_unit_that_is_not_its_answer() -> None:
    near, far = stream_pair("/node", "/master")

    async def run() -> None:
        client = RpcClient(near)
        server = CallServer()
        asking = asyncio.ensure_future(client.ask("echo", 1))
        server.take(await far.receive())
        await far.send(server.respond([1, "", 1]))
        assert await asking == 1
        asking = asyncio.ensure_future(client.ask("echo", 2))
        await far.receive()
        await far.send(dump_compact_answer(7, [1, "", 2]))
        with pytest.raises(CompactRefused, match="out of its turn"):
            await asking
        assert client.closed

    await run()


class Cut:
    """A stream that ends when something is sent."""

    def __init__(self) -> None:
        self.closed = False

    async def send(self, _: bytes) -> None:
        raise ChannelClosed("the peer ended the connection")

    async def close(self) -> None:
        self.closed = True


async def test_a_call_that_is_too_long_is_not_sent_and_the_next_has_its_number() -> None:
    near, far = stream_pair("/node", "/master")

    async def run() -> None:
        client = RpcClient(near)
        assert await client.ask("echo", 1) == [1]
        with pytest.raises(XmlRpcRefused, match="bytes, at most"):
            await client.ask("echo", b"x" * (xmlrpc.BODY_LIMIT + 1))
        assert await client.ask("echo", 2) == [2]
        assert not client.closed

    await serving(run(), far)


@pytest.mark.parametrize(("size", "kind"), [(10, ChannelClosed), (UNSHOWN_UNIT, XmlRpcRefused)])
async def test_a_long_call_that_ends_the_connection_says_what_may_be_wrong(
    size: int, kind: type[Exception]
) -> None:
    stream = Cut()
    client = RpcClient(stream)  # type: ignore[arg-type]
    with pytest.raises(kind):
        await client.call("echo", b"x" * size)
    assert client.closed
    assert stream.closed


async def test_a_long_answer_is_read_in_steps() -> None:
    near, far = stream_pair("/node", "/master")
    long = ["x" * 1000] * 100

    async def run() -> None:
        client = RpcClient(near)
        for _ in range(3):  # in XML-RPC, then in the compact form
            assert await client.ask("echo", long) == [long]
        assert client.is_compact

    await serving(run(), far)

"""One connection on which calls are answered, at once and later."""

import asyncio
from typing import Any

import pytest

from rossec.errors import HangUp, RossecError
from rossec.net.rpc.calls import CallLoop
from rossec.ros import xmlrpc
from rossec.ros.calls import CallClient, value_in
from rossec.ros.http import HttpClient
from rossec.ros.xmlrpc import BODY_LIMIT, Fault
from tests.support.streams import MemoryStream, stream_pair

_LONG = "x" * 1000


class Served:
    """A loop over one end of a pair, and a client's eyes at the other."""

    def __init__(self, idle: float | None = None, limit: int = 1000) -> None:
        self.near, self.far = stream_pair("/node", "/master")
        self.gate = asyncio.Event()
        self.begun = 0
        self.loop = CallLoop(self.far, self.dispatch, limit=limit, deadline=10, idle=idle)
        self.task = asyncio.ensure_future(self.loop.run())

    def dispatch(self, method: str, params: tuple[object, ...], peer: str) -> object:
        match method:
            case "now":
                return [peer, *params]
            case "later":
                return self.later(params)
            case "long":
                return _LONG
            case "long later":
                return self.long()
            case "gone":
                raise HangUp("nobody")
            case _:
                return self.gone()

    async def later(self, params: tuple[object, ...]) -> object:
        self.begun += 1
        await self.gate.wait()
        return list(params)

    async def long(self) -> object:
        return _LONG

    async def gone(self) -> object:
        raise HangUp("nobody")

    async def answer(self) -> Any:
        return await answer(self.near)


async def answer(stream: MemoryStream) -> Any:
    unit = await stream.receive()
    return xmlrpc.load_response(unit.partition(b"\r\n\r\n")[2])


def call(method: str, *params: object) -> bytes:
    return HttpClient("x").request(xmlrpc.dump_call(method, params))


async def test_calls_that_came_together_are_answered_one_by_one() -> None:
    served = Served()
    await served.near.send(call("now", 1) + call("now", 2))
    await served.near.send(call("now", 3))
    assert [await served.answer() for _ in range(3)] == [["/node", n] for n in (1, 2, 3)]
    await served.near.close()
    await served.task


async def test_a_call_in_pieces_is_answered_when_it_is_whole() -> None:
    served = Served()
    data = call("now", 1) + call("now", 2)
    for begin in range(0, len(data), 50):
        await served.near.send(data[begin : begin + 50])
    assert [await served.answer() for _ in range(2)] == [["/node", n] for n in (1, 2)]
    await served.near.close()
    await served.task


async def test_a_slow_call_delays_the_next_one() -> None:
    served = Served()
    await served.near.send(call("later", 1))
    await served.near.send(call("now", 2))
    served.gate.set()
    assert await served.answer() == [1]
    assert await served.answer() == ["/node", 2]
    await served.near.close()
    await served.task


@pytest.mark.parametrize("method", ["long", "long later"])
async def test_an_answer_is_no_longer_than_a_call_may_be(method: str) -> None:
    served = Served()
    await served.near.send(call(method))
    with pytest.raises(Fault, match=r"the answer has 11\d\d bytes, at most 1000 are sent"):
        await served.answer()
    await served.near.send(call("now", 2))
    assert await served.answer() == ["/node", 2]
    await served.near.close()
    await served.task


async def test_a_longer_limit_holds_for_the_parser_too() -> None:
    served = Served(limit=3 * BODY_LIMIT)
    long = "x" * (2 * BODY_LIMIT)
    await served.near.send(call("now", long))
    unit = await served.near.receive()
    body = unit.partition(b"\r\n\r\n")[2]
    assert xmlrpc.load_response(body, limit=3 * BODY_LIMIT) == ["/node", long]
    await served.near.close()
    await served.task


async def test_a_peer_that_lags_is_waited_for() -> None:
    served = Served()
    served.far.lags = True
    await served.near.send(call("now", 1) + call("now", 2))
    assert await served.answer() == ["/node", 1]
    assert await served.answer() == ["/node", 2]
    await served.near.close()
    await served.task


@pytest.mark.parametrize("method", ["gone", "gone later"])
async def test_a_hang_up_ends_the_connection(method: str) -> None:
    served = Served()
    await served.near.send(call(method))
    await served.task
    assert served.near.inbox.empty()


async def test_a_crash_of_the_loop_itself_is_raised(monkeypatch: pytest.MonkeyPatch) -> None:
    served = Served()

    def crash(unit: bytes) -> bool:
        raise ZeroDivisionError

    monkeypatch.setattr(served.far, "write_nowait", crash)
    await served.near.send(call("now"))
    with pytest.raises(ZeroDivisionError):
        await served.task


async def test_a_cancelled_server_leaves_no_coroutine_unawaited() -> None:
    served = Served()
    await asyncio.sleep(0)
    await served.near.send(call("later"))  # taken, and not begun
    served.task.cancel()
    await served.near.send(call("now"))  # nobody takes it
    with pytest.raises(asyncio.CancelledError):
        await served.task
    assert served.begun == 0


async def test_idle_time_ends_also_a_call_that_hangs() -> None:
    served = Served(idle=0.05)
    await served.near.send(call("later"))
    await served.task
    assert served.begun == 1


async def test_the_peer_leaves_during_a_call() -> None:
    served = Served()
    await served.near.send(call("later"))
    await asyncio.sleep(0)
    await served.near.close()
    served.gate.set()
    await served.task
    with pytest.raises(RossecError):
        await served.answer()


async def switched(served: Served, client: CallClient) -> None:
    """Make the first call, which is answered with the switch."""
    await served.near.send(client.request("now", (1,)))
    assert value_in(client.take(await served.near.receive())) == ["/node", 1]
    assert client.is_compact


async def test_units_are_answered_at_once_and_later() -> None:
    served, client = Served(), CallClient("x")
    await switched(served, client)
    served.gate.set()
    for method, expected in (("now", ["/node", 2]), ("later", [2]), ("now", ["/node", 2])):
        for _ in range(20):
            await served.near.send(client.request(method, (2,)))
            assert client.take(await served.near.receive()) == expected
    served.far.lags = True
    await served.near.send(client.request("now", (3,)))
    assert client.take(await served.near.receive()) == ["/node", 3]
    await served.near.close()
    await served.task


async def test_the_switch_may_come_with_a_later_answer() -> None:
    served, client = Served(), CallClient("x")
    served.gate.set()
    await served.near.send(client.request("later", (1,)))
    assert value_in(client.take(await served.near.receive())) == [1]
    assert client.is_compact
    await served.near.close()
    await served.task


@pytest.mark.parametrize("method", ["long", "long later"])
async def test_a_unit_too_is_no_longer_than_a_call_may_be(method: str) -> None:
    served, client = Served(limit=500), CallClient("x")
    await switched(served, client)
    await served.near.send(client.request(method, ()))
    with pytest.raises(Fault, match=r"the answer has 10\d\d bytes, at most 500 are sent"):
        value_in(client.take(await served.near.receive()))
    await served.near.send(client.request("now", (2,)))
    assert client.take(await served.near.receive()) == ["/node", 2]
    await served.near.close()
    await served.task


@pytest.mark.parametrize("method", ["now", "later"])
async def test_a_call_before_the_answer_ends_the_connection(method: str) -> None:
    served, client = Served(), CallClient("x")
    await switched(served, client)
    unit = client.request(method, (1,))
    if method == "now":  # both arrive before the first is looked at
        served.far.take, callback, served.far.callback = None, served.far.callback, None
        await served.near.send(unit)
        await served.near.send(unit)
        assert callback is not None
        callback()
    else:
        await served.near.send(unit)
        await asyncio.sleep(0)
        await served.near.send(unit)
    async with asyncio.timeout(30):
        await served.task
    assert served.near.inbox.empty()


@pytest.mark.parametrize("unit", [b"", b"POST / HTTP/1.1\r\n", b"\x84\x01\x01\x60\x00", b"\xc0\x60"])
async def test_what_is_not_a_unit_ends_the_connection_without_an_answer(unit: bytes) -> None:
    served = Served()
    await switched(served, CallClient("x"))
    await served.near.send(unit)
    async with asyncio.timeout(30):
        await served.task
    assert served.near.inbox.empty()


@pytest.mark.parametrize("method", ["gone", "gone later"])
async def test_a_hang_up_ends_units_too(method: str) -> None:
    served, client = Served(), CallClient("x")
    await switched(served, client)
    await served.near.send(client.request(method, ()))
    await served.task
    assert served.near.inbox.empty()


async def test_an_early_call_while_the_connection_runs_out_of_time() -> None:
    """Both end it; neither stands in the other's way."""
    served, client = Served(idle=0.05), CallClient("x")
    await switched(served, client)
    await served.near.send(client.request("later", (1,)))
    await asyncio.sleep(0)
    served.loop._scope.reschedule(0)
    await asyncio.sleep(0)
    assert served.loop._scope.expired()
    await served.near.send(client.request("now", (2,)))
    async with asyncio.timeout(30):
        await served.task

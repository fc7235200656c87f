"""The server side of a service, over real sockets: handlers, concurrency, restrictions."""

import asyncio
from typing import Any

import pytest

from grants.model import Restriction, Right
from rossec.errors import ChannelError, ConnectionHeaderRefused, ServiceFailed
from rossec.node import Node
from rossec.node import service as provider
from tests.support.lamp import BOOL, LAMP, called, only, switch
from tests.support.site import Site
from tests.support.witness import until


async def test_concurrent_calls_are_answered(lamp: Node, hall: Node) -> None:
    running: list[int] = []
    most = 0

    async def slow(request: Any) -> dict[str, object]:
        nonlocal most
        running.append(1)
        most = max(most, len(running))
        await asyncio.sleep(0.02)
        running.pop()
        return switch(request)

    await lamp.service(LAMP, BOOL, slow, concurrency=4)
    client = hall.client(LAMP, BOOL)
    async with asyncio.TaskGroup() as group:
        calls = [group.create_task(called(client, data=index % 2 == 0)) for index in range(8)]
    assert [call.result() for call in calls] == ["on is True", "on is False"] * 4
    assert most == 2


async def test_a_service_without_fields(lamp: Node, hall: Node) -> None:
    await lamp.service("/lamp/off", "std_srvs/Empty", lambda _: None)
    await hall.client("/lamp/off", "std_srvs/Empty")()


async def test_a_caller_receives_service_failed_and_no_other_exception(
    lamp: Node, hall: Node, caplog: pytest.LogCaptureFixture
) -> None:
    said: list[BaseException | object] = [
        ServiceFailed("the bulb is\nbroken"),
        ValueError("secret"),
        None,
        "no message",
        {"wrong": 1},
        {"success": "no truth value", "message": object()},
    ]

    def broken(_: Any) -> Any:
        result = said.pop(0)
        if isinstance(result, BaseException):
            raise result
        return result

    await lamp.service(LAMP, BOOL, broken)
    client = hall.client(LAMP, BOOL, persistent=True)
    with pytest.raises(ServiceFailed, match=r"^the bulb is\\u000abroken$"):
        await client(data=True)
    while said:
        with pytest.raises(ServiceFailed, match=r"^the service failed$"):
            await client(data=True)
    assert "secret" in caplog.text


async def test_a_call_to_a_slow_handler_fails(lamp: Node, hall: Node) -> None:
    async def never(_: Any) -> None:
        await asyncio.Event().wait()

    service = await lamp.service(LAMP, BOOL, never, deadline=0.05)
    with pytest.raises(ServiceFailed, match="took too long"):
        await hall.client(LAMP, BOOL)(data=True)
    await service.close()
    await lamp.service(LAMP, BOOL, never)
    client = hall.client(LAMP, BOOL, persistent=True, deadline=0.5)
    with pytest.raises(ServiceFailed, match="did not answer in time"):
        await client(data=True)
    await until(lambda: not client.links)  # a late answer could arrive: not used again


@pytest.mark.parametrize("side", ["caller", "provider"])
async def test_each_call_is_authorized_again(
    lamp: Node, hall: Node, side: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The call itself checks for expiry, before the watchdog does."""
    service = await lamp.service(LAMP, BOOL, switch)
    client = hall.client(LAMP, BOOL, persistent=True)
    await called(client, data=True)
    for node in (lamp, hall):
        monkeypatch.setattr(node._context.connections, "cut_ended", lambda _: None)
    (connection,) = (client if side == "caller" else service).links
    monkeypatch.setattr(connection, "ends", 0)
    with pytest.raises(ChannelError, match="expired" if side == "caller" else None):
        await client(data=True)
    await until(lambda: not service.links and not client.links)


async def test_conditions_and_filters_of_the_caller_are_applied(site: Site, lamp: Node) -> None:
    received: list[bool] = []

    def listen(request: Any) -> dict[str, object]:
        received.append(request.data)
        return switch(request)

    await lamp.service(LAMP, BOOL, listen)
    site.grant("/off", Right.CALL, LAMP, restriction=only("SetBoolRequest", "!msg.data"))
    site.grant("/dumb", Right.CALL, LAMP, restriction=only("SetBoolResponse", message="clear"))
    site.grant("/shy", Right.CALL, LAMP, restriction=only("SetBoolResponse", "!msg.success"))
    site.grant("/pose", Right.CALL, LAMP, restriction=Restriction("std_srvs/Other", ("now > 0",)))
    site.grant("/rare", Right.CALL, LAMP, restriction=Restriction(rate=0.001))
    async with site.node("/off") as off:
        client = off.client(LAMP, BOOL, persistent=True)
        assert await called(client, data=False) == "on is False"
        with pytest.raises(ServiceFailed, match=r"rossec: the grant .* does not allow this request"):
            await client(data=True)
        assert await called(client, data=False) == "on is False"
        with pytest.raises(ServiceFailed, match="rossec: "):  # malformed
            await client.call_bytes(b"too long")
    assert received == [False, False]
    async with site.node("/dumb") as dumb:
        response = await dumb.client(LAMP, BOOL)(data=True)
        assert (response.success, response.message) == (True, "")
        with pytest.raises(ServiceFailed, match="rossec: not one std_srvs/SetBoolRequest"):
            await dumb.client(LAMP, BOOL).call_bytes(b"too long")
    async with site.node("/shy") as shy:
        with pytest.raises(ServiceFailed, match="does not allow this response"):
            await shy.client(LAMP, BOOL)(data=True)
    async with site.node("/pose") as pose:
        with pytest.raises(ConnectionHeaderRefused, match="restricted for messages of type std_srvs/Other"):
            await pose.client(LAMP, BOOL)(data=True)
    async with site.node("/rare") as rare:
        client = rare.client(LAMP, BOOL, persistent=True)
        await called(client, data=True)
        with pytest.raises(ServiceFailed, match="does not allow this request"):
            await client(data=True)


async def test_an_incomplete_request_times_out(
    lamp: Node, hall: Node, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(provider, "REQUEST_DEADLINE", 0.05)
    service = await lamp.service(LAMP, BOOL, switch)
    client = hall.client(LAMP, BOOL, persistent=True)
    await called(client, data=True)
    (connection,) = client.links
    await connection.stream.send(b"\1\0")
    await until(lambda: not service.links and not client.links)

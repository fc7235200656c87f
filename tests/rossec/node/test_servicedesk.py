"""Services of nodes against a real master over real sockets: who may ask what, and what is cut."""

import asyncio
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

import pytest

from grants.errors import GrantError
from grants.model import Restriction, Right, filter_rules
from rossec.errors import (
    AnswerMalformed,
    AnswerRefused,
    ChannelError,
    ConfigurationError,
    MessageError,
    RossecError,
    ServiceFailed,
    ServiceRefused,
    ServiceUnavailable,
    TopicRefused,
)
from rossec.net.stream import SecureStream
from rossec.node import Node, ServiceClient, provider
from tests.support.site import Site
from tests.support.witness import until

LAMP = "/lamp/on"
BOOL = "std_srvs/SetBool"
TRIGGER = "std_srvs/Trigger"


@pytest.fixture
async def site(tmp_path: Path) -> AsyncIterator[Site]:
    async with Site(tmp_path / "site").running() as site:
        yield site


@pytest.fixture
async def lamp(site: Site) -> AsyncIterator[Node]:
    site.grant("/lamp", Right.PROVIDE, "/lamp/*")
    async with site.node("/lamp") as lamp:
        yield lamp


@pytest.fixture
async def hall(site: Site) -> AsyncIterator[Node]:
    site.grant("/hall", Right.CALL, "/lamp/*")
    async with site.node("/hall") as hall:
        yield hall


def switch(request: Any) -> dict[str, object]:
    return {"success": True, "message": f"on is {request.data}"}


async def called(client: ServiceClient, **fields: object) -> str:
    async with asyncio.timeout(20):
        message: str = (await client(**fields)).message
        return message


async def test_a_call_is_answered(lamp: Node, hall: Node) -> None:
    service = await lamp.service(LAMP, BOOL, switch)
    client = hall.client(LAMP, BOOL)
    response = await client(data=True)
    assert (response.success, response.message) == (True, "on is True")
    assert await called(client, data=False) == "on is False"
    assert (await client(client.create(data=True))).message == "on is True"
    await until(lambda: not service.links and not client.links)


async def test_many_calls_at_once(lamp: Node, hall: Node) -> None:
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


async def test_a_kept_connection(lamp: Node, hall: Node) -> None:
    service = await lamp.service(LAMP, BOOL, switch)
    async with hall.client(LAMP, BOOL, persistent=True) as client:
        assert await called(client, data=True) == "on is True"
        (link,) = service.links
        async with asyncio.TaskGroup() as group:  # calls take turns
            for _ in range(5):
                group.create_task(called(client, data=True))
        assert service.links == {link}
        link.stream.abort("the network broke")
        await until(lambda: not client.links)
        assert await called(client, data=False) == "on is False"  # over a new one
    await until(lambda: not service.links)
    with pytest.raises(ChannelError, match="closed"):
        await client(data=True)
    await client.close()


async def test_a_service_without_fields(lamp: Node, hall: Node) -> None:
    await lamp.service("/lamp/off", "std_srvs/Empty", lambda _: None)
    await hall.client("/lamp/off", "std_srvs/Empty")()


async def test_what_a_handler_says_and_what_it_does_not(
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


async def test_a_handler_that_takes_too_long(lamp: Node, hall: Node) -> None:
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
    await until(lambda: not client.links)  # the answer might still come: never used again


async def test_types_must_agree(lamp: Node, hall: Node) -> None:
    await lamp.service(LAMP, BOOL, switch)
    with pytest.raises(TopicRefused, match="has the checksum"):
        await hall.client(LAMP, TRIGGER)()
    with pytest.raises(MessageError, match="unknown service type"):
        hall.client(LAMP, "std_srvs/SetBoool")


async def test_names_are_resolved(site: Site, lamp: Node) -> None:
    await lamp.service("~on", BOOL, switch)
    site.grant("/hall", Right.CALL, LAMP)
    async with site.node("/hall", "light:=/lamp/on") as hall:
        assert await called(hall.client("light", BOOL), data=True) == "on is True"


async def test_mistakes_of_the_program(lamp: Node, hall: Node) -> None:
    await lamp.service(LAMP, BOOL, switch)
    with pytest.raises(ConfigurationError, match="provided by this node already"):
        await lamp.service(LAMP, BOOL, switch)
    for wrong in ({"concurrency": 0}, {"deadline": 0}):
        with pytest.raises(ConfigurationError, match="concurrency"):
            await lamp.service("/lamp/off", BOOL, switch, **wrong)
    with pytest.raises(ConfigurationError, match="deadline of 0 s"):
        hall.client(LAMP, BOOL, deadline=0)


async def test_there_is_no_provider(lamp: Node, hall: Node) -> None:
    with pytest.raises(ServiceUnavailable, match=f"no node provides {LAMP}"):
        await hall.client(LAMP, BOOL)(data=True)
    with pytest.raises(ServiceUnavailable, match=r"within 0\.1 s"):
        await hall.wait_for_service(LAMP, timeout=0.1)
    waiting = asyncio.ensure_future(hall.wait_for_service(LAMP, timeout=20))
    service = await lamp.service(LAMP, BOOL, switch)
    await waiting
    await service.close()
    with pytest.raises(ServiceUnavailable):
        await hall.client(LAMP, BOOL)(data=True)


async def test_without_the_right_to_call(site: Site, lamp: Node) -> None:
    await lamp.service(LAMP, BOOL, switch)
    site.enroll("/eve")
    async with site.node("/eve") as eve:
        with pytest.raises(AnswerRefused, match="call"):
            await eve.client(LAMP, BOOL)(data=True)
        with pytest.raises(AnswerRefused, match="call"):
            await eve.wait_for_service(LAMP, timeout=20)


async def test_without_the_right_to_provide(site: Site, hall: Node) -> None:
    async with site.node("/eve") as eve:
        with pytest.raises(RossecError, match="provide"):
            await eve.service(LAMP, BOOL, switch)
        with pytest.raises(RossecError, match="provide"):  # the first try left nothing behind
            await eve.service(LAMP, BOOL, switch)


async def tell(site: Site, node: Node, revoked: bytes) -> None:
    await node._session.call("rossec.updateRevocations", site.revoke(revoked))


async def test_a_revoked_caller_is_cut(site: Site, lamp: Node) -> None:
    right = site.grant("/hall", Right.CALL, LAMP)
    service = await lamp.service(LAMP, BOOL, switch)
    async with site.node("/hall") as hall:
        client = hall.client(LAMP, BOOL, persistent=True)
        await called(client, data=True)
        assert len(service.links) == 1
        await tell(site, lamp, right)
        await until(lambda: not service.links and not client.links)
        await hall._session._beat()  # a node that registers nothing hears with its heartbeat
        with pytest.raises((RossecError, GrantError)):
            await called(client, data=True)


async def test_a_revoked_provider_is_cut(site: Site, hall: Node) -> None:
    right = site.grant("/lamp", Right.PROVIDE, LAMP)
    async with site.node("/lamp") as lamp:
        service = await lamp.service(LAMP, BOOL, switch)
        client = hall.client(LAMP, BOOL, persistent=True)
        await called(client, data=True)
        await tell(site, hall, right)
        await hall._session._beat()
        await until(lambda: not service.links and not client.links)


@pytest.mark.parametrize("side", ["caller", "provider"])
async def test_each_call_is_judged_anew(
    lamp: Node, hall: Node, side: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Before the watch looks: what has ended is met by the call itself."""
    service = await lamp.service(LAMP, BOOL, switch)
    client = hall.client(LAMP, BOOL, persistent=True)
    await called(client, data=True)
    for node in (lamp, hall):
        monkeypatch.setattr(node._watch, "cut", lambda _: None)
    (link,) = (client if side == "caller" else service).links
    monkeypatch.setattr(link, "ends", 0)
    with pytest.raises(ChannelError, match="expired" if side == "caller" else None):
        await client(data=True)
    await until(lambda: not service.links and not client.links)


def only(kind: str, *conditions: str, **filters: object) -> Restriction:
    rules = filter_rules({path: {str(op): True} for path, op in filters.items()})
    return Restriction(f"std_srvs/{kind}", conditions, rules)


async def test_conditions_and_filters_of_the_caller(site: Site, lamp: Node) -> None:
    heard: list[bool] = []

    def listen(request: Any) -> dict[str, object]:
        heard.append(request.data)
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
        with pytest.raises(
            ServiceFailed, match=r"rossec: the grant .* does not allow this request"
        ):
            await client(data=True)
        assert await called(client, data=False) == "on is False"
        with pytest.raises(ServiceFailed, match="rossec: "):  # not one request
            await client.call_bytes(b"too long")
    assert heard == [False, False]
    async with site.node("/dumb") as dumb:
        response = await dumb.client(LAMP, BOOL)(data=True)
        assert (response.success, response.message) == (True, "")
        with pytest.raises(ServiceFailed, match="rossec: not one std_srvs/SetBoolRequest"):
            await dumb.client(LAMP, BOOL).call_bytes(b"too long")
    async with site.node("/shy") as shy:
        with pytest.raises(ServiceFailed, match="does not allow this response"):
            await shy.client(LAMP, BOOL)(data=True)
    async with site.node("/pose") as pose:
        with pytest.raises(TopicRefused, match="restricted for messages of type std_srvs/Other"):
            await pose.client(LAMP, BOOL)(data=True)
    async with site.node("/rare") as rare:
        client = rare.client(LAMP, BOOL, persistent=True)
        await called(client, data=True)
        with pytest.raises(ServiceFailed, match="does not allow this request"):
            await client(data=True)


async def test_restrictions_of_the_provider_are_the_caller_s_to_apply(
    site: Site, hall: Node
) -> None:
    heard: list[bool] = []

    def listen(request: Any) -> dict[str, object]:
        heard.append(request.data)
        return switch(request)

    site.grant("/lamp", Right.PROVIDE, LAMP, restriction=only("SetBoolRequest", "!msg.data"))
    site.grant("/lamp", Right.PROVIDE, LAMP, restriction=only("SetBoolResponse", message="clear"))
    async with site.node("/lamp") as lamp:
        await lamp.service(LAMP, BOOL, listen)
        client = hall.client(LAMP, BOOL)
        with pytest.raises(ServiceRefused, match="does not allow this request"):
            await client(data=True)
        assert await called(client, data=False) == ""
    assert heard == [False]


async def test_a_probe_asks_for_the_header_alone(lamp: Node, hall: Node) -> None:
    await lamp.service(LAMP, BOOL, switch)
    fields, provider = await hall.services.probe(LAMP)
    assert provider.name == "/lamp"
    assert fields["type"] == b"std_srvs/SetBool"
    assert (fields["request_type"], fields["response_type"]) == (
        b"std_srvs/SetBoolRequest",
        b"std_srvs/SetBoolResponse",
    )


async def test_a_right_that_is_gone_does_not_cost_the_others(
    site: Site, hall: Node, caplog: pytest.LogCaptureFixture
) -> None:
    gone = site.grant("/lamp", Right.PROVIDE, "/lamp/off")
    site.grant("/lamp", Right.PROVIDE, LAMP)
    async with site.node("/lamp") as lamp:
        await lamp.service("/lamp/off", BOOL, switch)
        await lamp.service(LAMP, BOOL, switch)
        newest = site.revoke(gone)
        await site.restart_master()
        await until(lambda: "/lamp/off is not registered again" in caplog.text)
        await until(lambda: hall.revocations.data == newest)  # it has met the new master
        await hall.wait_for_service(LAMP, timeout=20)
        with pytest.raises(ServiceUnavailable):
            await hall.client("/lamp/off", BOOL)(data=True)
        site.grant("/lamp", Right.PROVIDE, "/lamp/off")  # while it runs
        await hall.wait_for_service("/lamp/off", timeout=20)


async def test_what_is_known(lamp: Node, hall: Node, monkeypatch: pytest.MonkeyPatch) -> None:
    await lamp.service(LAMP, BOOL, switch)
    assert await hall.services.known() == {LAMP: ["/lamp"]}
    nonsenses: list[object] = [7, [[], []], [[], [], 7], [[], [], [7]], [[], [], [[LAMP, "x"]]]]
    for nonsense in nonsenses:

        async def answer(*_: object, value: object = nonsense) -> object:
            return value

        monkeypatch.setattr(hall._session._client, "ask", answer)
        with pytest.raises(AnswerMalformed, match="a system state that is none"):
            await hall.services.known()


async def test_messages_that_arrive_in_parts(
    site: Site, lamp: Node, hall: Node, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Units are what somebody sent at once: a frame may need several of them."""
    service = await lamp.service(LAMP, BOOL, switch)
    client = hall.client(LAMP, BOOL, persistent=True)
    send = SecureStream.send

    async def crumble(stream: SecureStream[Any], *pieces: bytes) -> None:
        data = b"".join(pieces)
        for at in range(0, len(data), 3):
            await send(stream, data[at : at + 3])
            await asyncio.sleep(0)

    monkeypatch.setattr(SecureStream, "send", crumble)
    assert await called(client, data=True) == "on is True"
    await service.close()


async def test_a_request_that_does_not_end(
    lamp: Node, hall: Node, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(provider, "REQUEST_DEADLINE", 0.05)
    service = await lamp.service(LAMP, BOOL, switch)
    client = hall.client(LAMP, BOOL, persistent=True)
    await called(client, data=True)
    (link,) = client.links
    await link.stream.send(b"\1\0")
    await until(lambda: not service.links and not client.links)


async def test_a_restarted_master_knows_the_service_again(
    site: Site, lamp: Node, hall: Node
) -> None:
    await lamp.service(LAMP, BOOL, switch)
    await site.restart_master()
    async with asyncio.timeout(20):
        while True:
            try:
                assert await called(hall.client(LAMP, BOOL), data=True) == "on is True"
                break
            except RossecError:
                await asyncio.sleep(0.05)

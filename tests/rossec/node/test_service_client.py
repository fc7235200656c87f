"""The client side of a service, over real sockets: persistent connections, probes, restrictions."""

import asyncio
from typing import Any

import pytest

from grants.model import Right
from rossec.errors import ChannelError, ConnectionHeaderRefused, MessageError, ServiceRefused
from rossec.net.aio import SecureStream
from rossec.node import Node
from rossec.ros.names import MASTER
from tests.support.lamp import BOOL, LAMP, called, only, switch
from tests.support.site import Site
from tests.support.witness import until

TRIGGER = "std_srvs/Trigger"


async def test_a_persistent_connection_is_used_again(lamp: Node, hall: Node) -> None:
    service = await lamp.service(LAMP, BOOL, switch)
    async with hall.client(LAMP, BOOL, persistent=True) as client:
        assert await called(client, data=True) == "on is True"
        (connection,) = service.links
        async with asyncio.TaskGroup() as group:  # one call at a time
            for _ in range(5):
                group.create_task(called(client, data=True))
        assert service.links == {connection}
        connection.stream.abort("the network broke")
        await until(lambda: not client.links)
        assert await called(client, data=False) == "on is False"  # over a new connection
    await until(lambda: not service.links)
    with pytest.raises(ChannelError, match="closed"):
        await client(data=True)
    await client.close()


async def test_types_must_agree(lamp: Node, hall: Node) -> None:
    await lamp.service(LAMP, BOOL, switch)
    with pytest.raises(ConnectionHeaderRefused, match="has the md5sum"):
        await hall.client(LAMP, TRIGGER)()
    with pytest.raises(MessageError, match="unknown service type"):
        hall.client(LAMP, "std_srvs/SetBoool")


async def test_the_caller_applies_the_restrictions_of_the_provider(site: Site, hall: Node) -> None:
    received: list[bool] = []

    def listen(request: Any) -> dict[str, object]:
        received.append(request.data)
        return switch(request)

    site.grant("/lamp", Right.PROVIDE, LAMP, restriction=only("SetBoolRequest", "!msg.data"))
    site.grant("/lamp", Right.PROVIDE, LAMP, restriction=only("SetBoolResponse", message="clear"))
    async with site.node("/lamp") as lamp:
        await lamp.service(LAMP, BOOL, listen)
        client = hall.client(LAMP, BOOL)
        with pytest.raises(ServiceRefused, match="does not allow this request"):
            await client(data=True)
        assert await called(client, data=False) == ""
    assert received == [False]


async def test_a_probe_requests_the_header_only(lamp: Node, hall: Node) -> None:
    await lamp.service(LAMP, BOOL, switch)
    fields, provider = await hall.services.probe(LAMP)
    assert provider.name == "/lamp"
    assert fields["type"] == b"std_srvs/SetBool"
    assert (fields["request_type"], fields["response_type"]) == (
        b"std_srvs/SetBoolRequest",
        b"std_srvs/SetBoolResponse",
    )


async def test_messages_may_arrive_in_several_units(
    site: Site, lamp: Node, hall: Node, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A frame may be sent in several units."""
    service = await lamp.service(LAMP, BOOL, switch)
    client = hall.client(LAMP, BOOL, persistent=True)
    send = SecureStream.send

    async def crumble(stream: SecureStream[Any], *pieces: bytes) -> None:
        data = b"".join(pieces)
        if stream.peer.name == MASTER:  # calls in the compact form are a unit each
            await send(stream, data)
            return
        for at in range(0, len(data), 3):
            await send(stream, data[at : at + 3])
            await asyncio.sleep(0)

    monkeypatch.setattr(SecureStream, "send", crumble)
    assert await called(client, data=True) == "on is True"
    await service.close()

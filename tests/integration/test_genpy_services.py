"""Calls of the built-in node are, byte for byte, those of ROS's own service classes."""

import asyncio
import io
import time
from pathlib import Path
from typing import Any

import pytest

from grants.model import Right
from rossec.node import Node
from rossec.ros import tcpros
from tests.support.site import Site

pytestmark = pytest.mark.ros


def serialized(message: Any) -> bytes:
    buffer = io.BytesIO()
    message.serialize(buffer)
    return buffer.getvalue()


def stock(name: str) -> Any:
    import roscpp.srv
    import std_srvs.srv

    package, leaf = name.split("/")
    return getattr({"std_srvs": std_srvs.srv, "roscpp": roscpp.srv}[package], leaf)


CALLS: list[tuple[str, dict[str, object], dict[str, object]]] = [
    ("std_srvs/Empty", {}, {}),
    ("std_srvs/Trigger", {}, {"success": True, "message": "räumt auf"}),
    ("std_srvs/SetBool", {"data": True}, {"success": False, "message": ""}),
    ("roscpp/SetLoggerLevel", {"logger": "ros", "level": "debug"}, {}),
]


@pytest.mark.parametrize(("name", "asked", "answered"), CALLS, ids=[c[0] for c in CALLS])
async def test_genpy_services_are_called_over_a_real_master(
    tmp_path: Path, name: str, asked: dict[str, object], answered: dict[str, object]
) -> None:
    """The request and the response as received, against genpy's bytes."""
    service_class = stock(name)
    request = service_class._request_class(**asked)
    response = service_class._response_class(**answered)
    seen: list[bytes] = []
    async with Site(tmp_path / "site").running() as site:
        site.grant("/server", Right.PROVIDE, "/service")
        site.grant("/client", Right.CALL, "/service")
        async with site.node("/server") as server, site.node("/client") as caller:

            def handle(message: Any) -> dict[str, object]:
                seen.append(bytes(service.kind.request.serialize(message)))
                return answered

            service = await server.service("/service", name, handle)
            assert service.kind.md5sum == service_class._md5sum
            await caller.wait_for_service("/service", timeout=20)
            client = caller.client("/service", name)
            by_field = await client(**asked)
            assert bytes(client.kind.response.serialize(by_field)) == serialized(response)
            assert await client.call_bytes(serialized(request)) == serialized(response)
            await check_the_wire(caller, service_class, request, response)
    assert seen == [serialized(request)] * 3


async def check_the_wire(caller: Node, service_class: Any, request: Any, response: Any) -> None:
    """What rospy's own code writes to a service, and reads from it (rospy/impl/tcpros_service)."""
    from rospy.msg import deserialize_messages, serialize_message

    fields = {
        "service": "/service",
        "md5sum": service_class._md5sum,
        "callerid": "/client",
        "rossec_grants": caller.access.present(Right.CALL, "/service", int(time.time())),
    }
    asked, expected = io.BytesIO(), io.BytesIO(b"\1")
    serialize_message(asked, 0, request)
    expected.seek(1)
    serialize_message(expected, 0, response)
    stream = await caller.services.dial("/service")
    try:
        async with asyncio.timeout(20):
            await stream.send(tcpros.encode(fields))
            await stream.receive()
            await stream.send(asked.getvalue())
            answer = await stream.receive()
    finally:
        stream.abort("seen")
    assert answer == expected.getvalue()
    read: list[Any] = []
    buffer = io.BytesIO(answer[1:])
    buffer.seek(len(answer) - 1)
    deserialize_messages(buffer, read, service_class._response_class)
    assert read == [response]

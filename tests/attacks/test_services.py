"""Services on the network: callers, providers and probes without a right, past the master."""

import asyncio
import contextlib
from collections.abc import AsyncIterator
from typing import Any, Final

import pytest

from ca.encoding import encode
from grants.errors import GrantError, GrantMissing
from grants.model import Right
from rossec.demo.intruder import accept_any
from rossec.errors import ChannelError, RossecError
from rossec.net.aio import SecureServer, SecureStream, connect, serve
from rossec.node import Node
from rossec.node import service as provider
from rossec.node.node import first_frame
from rossec.participant.access import FIELD
from rossec.participant.handshakes import ExpectedService, server_header
from rossec.participant.service_types import service_type
from rossec.ros import tcpros
from rossec.ros import tcpros as wire
from tests.support.attacker import EVE, HOST, credentials, expect_refused, listen, send_header, signed
from tests.support.contexts import unlimited
from tests.support.site import Site
from tests.support.witness import until

SERVICE: Final = "/lamp/on"
BOOL: Final = "std_srvs/SetBool"
KIND: Final = service_type(BOOL)
REQUEST: Final = b"\1\0\0\0\1"


@pytest.fixture
async def lamp(site: Site, caplog: pytest.LogCaptureFixture) -> AsyncIterator[Node]:
    listen(caplog)
    site.grant("/lamp", Right.PROVIDE, "/lamp/*")
    async with site.node("/lamp") as lamp:
        lamp_calls.clear()
        await lamp.service(SERVICE, BOOL, switch)
        yield lamp


lamp_calls: list[bool] = []


def switch(request: Any) -> dict[str, object]:
    lamp_calls.append(request.data)
    return {"success": True}


def asking(grants: list[bytes] | None, service: str = SERVICE, **changes: str) -> dict[str, str | bytes]:
    fields: dict[str, str | bytes] = {"callerid": EVE, "service": service, "md5sum": "*", **changes}
    return fields if grants is None else {**fields, FIELD: encode(list(grants))}


def may_call(site: Site, pattern: str = SERVICE) -> bytes:
    return signed(site, right=Right.CALL, pattern=pattern)


def port_of(node: Node) -> int:
    return node.topic_endpoint()[1]


@pytest.mark.attack("service-no-grant")
@pytest.mark.parametrize("probe", [{}, {"probe": "1"}], ids=["call", "probe"])
async def test_a_caller_without_a_right_learns_nothing(
    site: Site, lamp: Node, caplog: pytest.LogCaptureFixture, probe: dict[str, str]
) -> None:
    """The answers for a service that exists and one that does not differ in its name alone."""
    said = []
    for service in (SERVICE, "/lamp/no"):
        heard = await send_header(port_of(lamp), credentials(site), asking([], service, **probe))
        expect_refused(heard, caplog, GrantMissing, "call")
        said.append(heard.error.replace(service, "?"))
    assert said[0] == said[1]
    assert lamp_calls == []


@pytest.mark.attack("service-no-grant")
async def test_other_rights_do_not_allow_a_call(
    site: Site, lamp: Node, caplog: pytest.LogCaptureFixture
) -> None:
    for right in Right:
        if right is not Right.CALL:
            grants = [signed(site, right=right, pattern=SERVICE)]
            heard = await send_header(port_of(lamp), credentials(site), asking(grants))
            expect_refused(heard, caplog, GrantMissing, "no grant for call")
    assert lamp_calls == []


@pytest.mark.attack("service-no-grant")
async def test_only_authorized_callers_learn_what_exists(site: Site, lamp: Node) -> None:
    grants = [may_call(site, "/lamp/*")]
    heard = await send_header(port_of(lamp), credentials(site), asking(grants, probe="1"))
    assert heard.fields["type"] == BOOL.encode()
    assert heard.after == b""
    heard = await send_header(port_of(lamp), credentials(site), asking(grants, "/lamp/no", probe="1"))
    assert heard.error == "rossec: /lamp does not provide /lamp/no"
    heard = await send_header(port_of(lamp), credentials(site), asking(grants, md5sum="0" * 32))
    assert "has the md5sum" in heard.error
    heard = await send_header(port_of(lamp), credentials(site), asking(grants, topic="/lamp/on"))
    assert "for a topic and for a service" in heard.error
    assert lamp_calls == []


@contextlib.asynccontextmanager
async def open_call(
    site: Site, lamp: Node, grant: bytes | None = None, **changes: str
) -> AsyncIterator[SecureStream[Any]]:
    """Eve's connection after the headers."""
    stream = await connect(HOST, port_of(lamp), unlimited(credentials(site), accept_any))
    try:
        await stream.send(tcpros.encode(asking([grant or may_call(site)], **changes)))
        async with asyncio.timeout(30):
            assert b"request_type" in await stream.receive()
        yield stream
    finally:
        stream.abort("done")


async def ended(stream: SecureStream[Any]) -> bytes:
    data = b""
    with contextlib.suppress(ChannelError):
        async with asyncio.timeout(20):
            while True:
                data += await stream.receive()
    return data


@pytest.mark.attack("service-no-grant")
async def test_an_authorized_call_succeeds(site: Site, lamp: Node) -> None:
    async with open_call(site, lamp) as stream:
        await stream.send(REQUEST)
        assert await ended(stream) == b"\1\5\0\0\0\1\0\0\0\0"
    assert lamp_calls == [True]


@pytest.mark.attack("service-occupied")
@pytest.mark.parametrize(
    "data",
    [
        (wire.REQUEST_LIMIT + 1).to_bytes(4, "little"),
        b"\xff\xff\xff\xff",
        REQUEST + REQUEST,
        REQUEST + b"\0",
        bytes(100_000),
    ],
    ids=["too long", "far too long", "two at once", "a tail", "thousands"],
)
async def test_requests_out_of_turn_end_the_connection(site: Site, lamp: Node, data: bytes) -> None:
    async with open_call(site, lamp, persistent="1") as stream:
        await stream.send(data)
        assert await ended(stream) == b""
    assert lamp_calls == []


@pytest.mark.attack("service-occupied")
@pytest.mark.parametrize("persistent", ["0", "1"])
async def test_a_request_that_never_ends_times_out(
    site: Site, lamp: Node, persistent: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(provider, "REQUEST_DEADLINE", 0.1)
    async with open_call(site, lamp, persistent=persistent) as stream:
        await stream.send(REQUEST[:3])
        assert await ended(stream) == b""
    assert lamp_calls == []


@pytest.mark.attack("service-occupied")
async def test_a_malformed_request_fails_only_its_call(site: Site, lamp: Node) -> None:
    async with open_call(site, lamp, persistent="true") as stream:
        for nonsense in (b"\0\0\0\0", b"\2\0\0\0\1\1", tcpros.frame(bytes(300_000))):
            await stream.send(nonsense)
            async with asyncio.timeout(30):
                answer = await stream.receive()
            assert answer[:1] == b"\0"
            assert answer[5:] == b"rossec: not one std_srvs/SetBoolRequest"
        await stream.send(REQUEST)
        async with asyncio.timeout(30):
            assert (await stream.receive())[:1] == b"\1"
    assert lamp_calls == [True]


@pytest.mark.attack("outlived-right")
async def test_a_call_in_progress_ends_with_its_grant(site: Site, lamp: Node) -> None:
    """Revoked between the request and the response: the response is not sent."""
    begun, go_on = asyncio.Event(), asyncio.Event()

    async def wait(_: Any) -> dict[str, object]:
        begun.set()
        await go_on.wait()
        return {"success": True, "message": "secret"}

    service = await lamp.service("/lamp/slow", BOOL, wait)
    grant = may_call(site, "/lamp/slow")
    async with open_call(site, lamp, grant, service="/lamp/slow", persistent="1") as stream:
        await stream.send(REQUEST)
        await begun.wait()
        await lamp._membership.session.call("rossec.updateRevocations", site.revoke(grant))
        assert await ended(stream) == b""
        go_on.set()
    await until(lambda: not service.links)


@pytest.mark.attack("service-occupied")
async def test_one_caller_cannot_use_every_worker(site: Site, lamp: Node) -> None:
    held = asyncio.Semaphore(0)

    async def wait(request: Any) -> dict[str, object]:
        if request.data:
            await held.acquire()
        return {"success": True}

    service = await lamp.service("/lamp/slow", BOOL, wait, concurrency=4)
    grant = may_call(site, "/lamp/slow")
    site.grant("/hall", Right.CALL, "/lamp/slow")
    async with contextlib.AsyncExitStack() as stack:
        for _ in range(6):
            stream = await stack.enter_async_context(
                open_call(site, lamp, grant, service="/lamp/slow", persistent="1")
            )
            await stream.send(REQUEST)
        await until(lambda: len(service.links) == 6)
        async with site.node("/hall") as hall, asyncio.timeout(20):
            assert (await hall.client("/lamp/slow", BOOL)(data=False)).success


@pytest.mark.attack("outlived-right")
async def test_a_revoked_key_cannot_call(site: Site, lamp: Node) -> None:
    async with open_call(site, lamp, persistent="1") as stream:
        revoked = site.revoke(site.identity(EVE).thumbprint)
        await lamp._membership.session.call("rossec.updateRevocations", revoked)
        assert await ended(stream) == b""
    with pytest.raises((RossecError, AssertionError)):
        async with open_call(site, lamp):
            pass
    assert lamp_calls == []


# --- providers


@contextlib.asynccontextmanager
async def impostor(
    site: Site, hall: Node, answer: dict[str, bytes], heard: list[bytes], reply: bytes = b""
) -> AsyncIterator[None]:
    """Eve answers at the address that the master names for the service."""

    async def play(stream: SecureStream[Any]) -> None:
        await first_frame(stream)
        await stream.send(tcpros.encode(answer))
        heard.append(await stream.receive())
        await stream.send(reply)
        await stream.wait_ended()

    server: SecureServer[Any] = serve(play, HOST, 0, unlimited(credentials(site), accept_any))

    async def lookup(_: str) -> str:
        return f"rosrpc://{HOST}:{server.port}"

    try:
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(hall.services, "lookup", lookup)
            yield
    finally:
        await server.close()


@pytest.fixture
async def hall(site: Site) -> AsyncIterator[Node]:
    site.grant("/hall", Right.CALL, "/lamp/*")
    async with site.node("/hall") as hall:
        yield hall


def answering(site: Site, grants: list[bytes], **changes: bytes) -> dict[str, bytes]:
    kind = ExpectedService(BOOL, KIND.md5sum)

    class Nothing:
        def present(self, *_: object) -> bytes:
            return encode(list(grants))

    return {**server_header(EVE, SERVICE, kind, Nothing(), 0), **changes}  # type: ignore[arg-type]


@pytest.mark.attack("service-no-grant")
async def test_a_provider_without_the_right_gets_no_request(site: Site, hall: Node) -> None:
    for grants in ([], [may_call(site)], [signed(site, right=Right.PROVIDE, pattern="/lamp/no")]):
        heard: list[bytes] = []
        async with impostor(site, hall, answering(site, grants), heard):
            with pytest.raises(GrantError):
                await hall.client(SERVICE, BOOL)(data=True)
            with pytest.raises(GrantError):
                await hall.wait_for_service(SERVICE, timeout=20)
        assert heard == []


@pytest.mark.attack("service-no-grant")
async def test_a_provider_under_another_name_or_type_gets_no_request(site: Site, hall: Node) -> None:
    right = [signed(site, right=Right.PROVIDE, pattern=SERVICE)]
    for changes in ({"callerid": b"/lamp"}, {"md5sum": b"0" * 32}, {"error": b"no\x1b[2J"}):
        heard: list[bytes] = []
        async with impostor(site, hall, answering(site, right, **changes), heard):
            with pytest.raises(RossecError) as caught:
                await hall.client(SERVICE, BOOL)(data=True)
            assert str(caught.value).isprintable()
        assert heard == []


@pytest.mark.attack("service-no-grant")
@pytest.mark.parametrize(
    "reply",
    [b"\2\0\0\0\0", b"\1\xff\xff\xff\xff", b"\1\0\0\0\0", b"\1\5\0\0\0\1\0\0\0\0!", b"\0\3\0\0\0a\nb"],
    ids=["mark", "too long", "no response", "a tail", "a failure"],
)
async def test_a_malformed_response_fails_the_call(site: Site, hall: Node, reply: bytes) -> None:
    right = [signed(site, right=Right.PROVIDE, pattern=SERVICE)]
    heard: list[bytes] = []
    async with impostor(site, hall, answering(site, right), heard, reply):
        client = hall.client(SERVICE, BOOL, persistent=True)
        with pytest.raises(RossecError) as caught:
            await client(data=True)
        assert str(caught.value).isprintable()
        await client.close()
    assert heard == [REQUEST]

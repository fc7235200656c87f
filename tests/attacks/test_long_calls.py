"""Long calls, of peers without a right and of peers with one: others are answered meanwhile."""

import asyncio
import contextlib
import time
from collections.abc import AsyncIterator
from typing import Any

import pytest

from grants.model import Right
from rossec.errors import RossecError
from rossec.master.operation.config import MasterLimits
from rossec.net.rpc.calls import RpcClient
from rossec.participant.connections import UNSHOWN_CONNECTIONS
from rossec.ros import xmlrpc
from rossec.ros.calls import CallClient
from rossec.ros.xmlrpc import Fault
from tests.support.attacker import EVE, HOST, credentials, dial
from tests.support.caller import caller
from tests.support.site import Site
from tests.support.witness import Witness

MANY = [1] * 30_000  # 0.9 MiB of XML
COUNT = 32


@contextlib.asynccontextmanager
async def clients(
    site: Site, uri: str, count: int = COUNT, *, compact: bool = True
) -> AsyncIterator[list[RpcClient]]:
    """Connections of Eve, who has shown nothing."""
    own = credentials(site)
    found = [RpcClient(await dial(uri, own), compact=compact, deadline=60) for _ in range(count)]
    try:
        yield found
    finally:
        for each in found:
            await each.close()


async def outcome(client: RpcClient, method: str, *params: object) -> object:
    try:
        return await client.call(method, EVE, *params)
    except (Fault, RossecError) as error:
        return error


@pytest.mark.attack("long-calls")
@pytest.mark.parametrize("compact", [True, False])
async def test_a_long_call_without_a_right_is_not_parsed(site: Site, compact: bool) -> None:
    assert site.master is not None
    async with clients(site, site.master.uri, 1, compact=compact) as (eve,):
        await eve.call("getPid", EVE)
        heard = await outcome(eve, "setParam", "/x", MANY if not compact else "x" * 900_000)
        assert isinstance(heard, Fault)
        assert "at most 65536 are taken from a caller that has shown no grant" in heard.faultString
        assert (await eve.call("getPid", EVE))[0] == 1, "it may go on"  # type: ignore[index]


@pytest.mark.attack("long-calls")
async def test_a_long_call_is_taken_once_a_grant_was_shown(site: Site) -> None:
    """Also one of several megabytes, on the connection by which the grant was presented."""
    assert site.master is not None
    site.grant(EVE, Right.PARAM_SET | Right.PARAM_GET, f"{EVE}/**")
    async with clients(site, site.master.uri, 1) as (eve,):
        grants = list(site.enroll(EVE).grants())
        assert await eve.ask("rossec.presentGrants", EVE, grants) == 1
        long = {f"p{number}": ["x" * 50, number] for number in range(25_000)}
        await eve.ask("setParam", EVE, f"{EVE}/long", long)
        assert await eve.ask("getParam", EVE, f"{EVE}/long") == long


@pytest.mark.attack("long-calls")
@pytest.mark.parametrize("granted", [False, True])
async def test_others_are_answered_before_many_long_calls_are(site: Site, granted: bool) -> None:
    """Others call without end, and no call of theirs waits for one of Eve's to end."""
    assert site.master is not None
    if granted:
        site.grant(EVE, Right.PARAM_SET, f"{EVE}/**")
    async with caller(site, "/other") as other, contextlib.AsyncExitStack() as stack:
        count = COUNT - 1 if granted else MasterLimits().connections_without_right - 1
        (first,) = await stack.enter_async_context(clients(site, site.master.uri, 1))
        await first.call("rossec.presentGrants", EVE, list(site.enroll(EVE).grants()))
        eves = await stack.enter_async_context(clients(site, site.master.uri, count, compact=False))
        calls = [asyncio.ensure_future(outcome(eve, "setParam", f"{EVE}/long", MANY)) for eve in eves]
        answered, longest = 0, 0.0
        while not all(each.done() for each in calls):
            began = time.monotonic()
            assert (await other("getPid"))[0] == 1
            answered, longest = answered + 1, max(longest, time.monotonic() - began)
        if granted:
            assert answered > 3 * count, "a turn is much shorter than a call"
            assert all(each.result()[0] == 1 for each in calls)  # type: ignore[index]
        assert longest < 2


@pytest.mark.attack("costly-calls")
async def test_short_calls_with_long_answers_delay_nobody(site: Site) -> None:
    """Thirty of them arrive together: another call is answered before most of them are."""
    assert site.master is not None
    site.grant(EVE, Right.PARAM_SET | Right.PARAM_GET, f"{EVE}/**")
    async with (
        caller(site, "/other") as other,
        clients(site, site.master.uri, 1) as (first,),
        contextlib.AsyncExitStack() as stack,
    ):
        await first.call("rossec.presentGrants", EVE, list(site.enroll(EVE).grants()))
        await outcome(first, "setParam", f"{EVE}/long", MANY)
        eves = await stack.enter_async_context(clients(site, site.master.uri, COUNT - 2))
        for each in eves:
            await each.call("getPid", EVE)
        before = site.master.effects.calls
        calls = [asyncio.ensure_future(each.fetch("getParam", EVE, f"{EVE}/long")) for each in eves]
        await asyncio.sleep(0)
        assert (await other("getPid"))[0] == 1
        assert site.master.effects.calls <= before + COUNT // 3
        answers = [xmlrpc.load_response(each) for each in await asyncio.gather(*calls)]
        assert all(xmlrpc.value_of(each) == MANY for each in answers)


@pytest.mark.attack("long-calls")
async def test_a_peer_without_a_right_has_few_connections_to_the_master(site: Site) -> None:
    assert site.master is not None
    most = MasterLimits().connections_without_right
    async with clients(site, site.master.uri, most) as eves:
        assert all([(await each.call("getPid", EVE))[0] == 1 for each in eves])  # type: ignore[index]
        more = RpcClient(await dial(site.master.uri, credentials(site)))
        with pytest.raises(RossecError):
            await more.call("getPid", EVE)
        await more.close()
        async with caller(site, "/other", {"/t": Right.SUBSCRIBE}) as other:
            assert (await other("getPid"))[0] == 1


@pytest.mark.attack("long-calls")
async def test_a_peer_without_a_grant_silences_no_node(site: Site, witness: Witness) -> None:
    """Few connections, no long calls; the node publishes meanwhile."""
    uri = f"http://{HOST}:{witness.robot._listener.slave_port}/"
    body = CallClient("x", compact=False).request("getPid", (EVE, MANY))
    streams: list[Any] = []

    async def flood() -> int:
        """How many answers one connection was given."""
        stream = await dial(uri, credentials(site))
        streams.append(stream)
        answers = 0
        with contextlib.suppress(RossecError):
            for _ in range(2):
                await stream.send(body)
                assert b"has shown no grant" in await stream.receive()
                answers += 1
        return answers

    floods = [asyncio.ensure_future(flood()) for _ in range(2 * UNSHOWN_CONNECTIONS)]
    await witness.goes_on()
    answers = await asyncio.gather(*floods)
    assert sum(map(bool, answers)) <= UNSHOWN_CONNECTIONS
    assert any(answers)
    for stream in streams:
        stream.abort("enough")

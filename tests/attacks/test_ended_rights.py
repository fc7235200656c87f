"""A right that has ended stays ended: attacks D1, D2 and D6, against a running master."""

import asyncio

import pytest

from grants.model import Right
from rossec.errors import RossecError
from rossec.net.rpc.calls import RpcClient
from tests.support.attacker import EVE, call, dial
from tests.support.caller import caller
from tests.support.site import Site
from tests.support.witness import Witness

T = "std_msgs/String"


@pytest.mark.attack("old-permission")
async def test_d1_an_older_and_wider_grant_stays_revoked(site: Site) -> None:
    """It was revoked when a narrower one replaced it; its file still exists."""
    wide = site.grant(EVE, Right.PUBLISH, "/**")
    narrow = site.grant(EVE, Right.PUBLISH, "/eve/t")
    async with caller(site, "/other") as other:
        await other("rossec.updateRevocations", site.revoke(wide))
    await site.restart_master()
    async with caller(site, EVE) as eve:
        await eve("rossec.presentGrants", [wide, narrow])
        assert "revoked" in await eve.refused("registerPublisher", "/robot/t", T, eve.uri)
        assert (await eve("registerPublisher", "/eve/t", T, eve.uri))[0] == 1


@pytest.mark.attack("old-permission")
async def test_d1_an_older_delegation_stays_withdrawn(site: Site) -> None:
    """A withdrawn delegation renews nothing, whatever node sends it again."""
    assert site.master is not None
    older = site.delegate()
    await site.restart_master()
    async with caller(site, EVE, {"/t": Right.PUBLISH}) as eve:
        site.authority.revoke_delegations("test", site.now())
        newest = site.authority.store.newest_list()
        assert (await eve("rossec.updateRevocations", newest))[2] == 1
        assert (await eve("rossec.updateDelegation", older))[2] == 0
        short = site.grant(EVE, Right.PUBLISH, "/t", lifetime=60, cap=9999)
        [renewed] = (await eve("rossec.renewGrants", [short]))[2]
        assert renewed == b""


@pytest.mark.attack("outlived-right")
async def test_d2_a_node_that_never_restarts_loses_its_right_at_once(site: Site, witness: Witness) -> None:
    """Its connections stay open meanwhile, and it gets no calls."""
    async with caller(site, EVE, {"/t": Right.SUBSCRIBE, "/p": Right.PARAM_GET}) as eve:
        await eve("registerSubscriber", "/t", T, eve.uri)
        await eve("subscribeParam", eve.uri, "/p")
        async with caller(site, "/other", {"/t": Right.PUBLISH, "/p": Right.PARAM_SET}) as other:
            for grant in site.enroll(EVE).grants():
                await other("rossec.updateRevocations", site.revoke(grant))
            eve.told.clear()
            await other("registerPublisher", "/t", T, other.uri)
            await other("setParam", "/p", 1)
            assert (await other("getPid"))[0] == 1
            assert [told for told in eve.told if told[0] != "rossec.revocationUpdate"] == []
            assert "revoked" in await eve.refused("registerSubscriber", "/t", T, eve.uri)
            assert (await eve("getSystemState"))[2] == [[], [], []]


@pytest.mark.attack("outlived-right")
async def test_d6_a_connection_ends_with_its_identity(site: Site) -> None:
    assert site.master is not None
    short = site.enroll("/short", 4)
    client = RpcClient(await dial(site.master.uri, short.credentials()))
    assert await client.ask("getPid", "/short")
    async with asyncio.timeout(30):
        await client._stream.wait_ended()  # type: ignore[attr-defined]
    await asyncio.sleep(1.1)  # the last second may be rounded in its favour
    with pytest.raises(RossecError):
        await call(site.master.uri, short.credentials(), "getPid", "/short")

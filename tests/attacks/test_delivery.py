"""Grants delivered by the master: who deposits, who is given what, and what it costs others."""

import asyncio
import contextlib
from collections.abc import AsyncIterator
from typing import Any

import pytest

from grants import document
from grants.model import Right
from rossec.errors import ChannelError, RossecError
from rossec.master.api.statement_calls import DEPOSIT_LIMIT
from rossec.master.operation.config import MasterLimits
from rossec.master.rights.held_grants import MAX_HELD
from rossec.net.rpc.calls import RpcClient
from rossec.ros.names import AUTHORITY
from tests.attacks.test_intermediates import below
from tests.support.attacker import EVE, credentials, dial, revoke, signed
from tests.support.caller import Caller, caller, refusal
from tests.support.site import Site
from tests.support.witness import TOPIC, Witness, until

DEPOSIT, STATES = "rossec.depositGrants", "rossec.deliveryStates"
FETCH, WATCH = "rossec.fetchGrants", "rossec.watchGrants"
ONLY = "only the authority's own node /ca may call this"


@contextlib.asynccontextmanager
async def authority(site: Site) -> AsyncIterator[Caller]:
    """The authority's own node."""
    async with caller(site, AUTHORITY) as office:
        yield office


async def fetched(who: Caller, known: bytes = b"") -> list[bytes]:
    code, _, value = await who(FETCH, known)
    assert code == 1
    grants: list[bytes] = value["grants"]
    return grants


@pytest.mark.attack("console-disclosure")
async def test_only_the_authoritys_own_node_learns_who_was_denied_and_who_lags(
    site: Site, witness: Witness
) -> None:
    """Names of other nodes, and what they tried: each right of the domain is not enough."""
    below(site, AUTHORITY)
    async with caller(site, EVE, {"/**": Right(255)}) as eve, authority(site) as false:
        for method in ("rossec.recentDenials", "rossec.revocationStatus"):
            assert ONLY in await eve.refused(method)
            assert "cannot act as another" in refusal(await eve.lie(method, AUTHORITY))
            assert ONLY in await false.refused(method)
            calls = [{"methodName": method, "params": [EVE]}]
            answers: Any = await eve.client.call("system.multicall", calls)
            assert ONLY in refusal(answers[0][0])
    await witness.goes_on()


@pytest.mark.attack("deposit-by-another")
async def test_only_the_authoritys_own_node_deposits_grants(
    site: Site, witness: Witness, caplog: pytest.LogCaptureFixture
) -> None:
    """A node would fill the disks of the master and of other nodes; each right is not enough."""
    data = signed(site)
    async with caller(site, EVE, {"/**": Right(255)}) as eve:
        assert ONLY in await eve.refused(DEPOSIT, [data])
        assert ONLY in await eve.refused(STATES, [document.grant_id(data) + bytes(32)])
        assert "/eve may not rossec.depositGrants" in caplog.text, "for the audit"
        calls = [{"methodName": DEPOSIT, "params": [EVE, [data]]}]
        answers: Any = await eve.client.call("system.multicall", calls)
        assert ONLY in refusal(answers[0][0])
        assert "cannot act as another" in refusal(await eve.lie(DEPOSIT, AUTHORITY, [data]))
        assert await fetched(eve) == []
    await witness.goes_on()


@pytest.mark.attack("deposit-by-another")
async def test_a_name_below_an_intermediate_is_not_the_authority(site: Site, witness: Witness) -> None:
    """Whoever holds an intermediate certifies `/ca` for a key of its own."""
    site.enroll(AUTHORITY)
    below(site, AUTHORITY)
    async with authority(site) as impostor:
        assert ONLY in await impostor.refused(DEPOSIT, [signed(site)])
    await witness.goes_on()


@pytest.mark.attack("fetch-of-anothers-grants")
async def test_a_node_is_given_the_grants_of_its_own_key_only(site: Site, witness: Witness) -> None:
    """A grant says what its holder may do, and under which conditions."""
    secret = site.publish("/victim", "/secret")
    async with authority(site) as office, caller(site, EVE) as eve:
        assert (await office(DEPOSIT, [secret]))[0] == 1
        assert await fetched(eve) == []
        for method in (FETCH, WATCH):
            assert "cannot act as another" in refusal(await eve.lie(method, "/victim", b""))
        waiting = asyncio.ensure_future(eve(WATCH, b""))
        other = site.publish("/victim", "/other")
        assert (await office(DEPOSIT, [other]))[0] == 1
        await asyncio.sleep(0.2)
        assert not waiting.done(), "not even when others are given something"
        own = signed(site)
        assert (await office(DEPOSIT, [own]))[0] == 1
        async with asyncio.timeout(30):
            assert (await waiting)[2]["grants"] == [own]
        async with caller(site, "/victim") as victim:
            assert await fetched(victim) == [secret, other]
    await witness.goes_on()


@pytest.mark.attack("delivery-of-a-withdrawn-grant")
async def test_a_withdrawn_grant_is_neither_given_nor_deposited_again(site: Site, witness: Witness) -> None:
    """Deposited before it was revoked, and after; and a key that was revoked."""
    grant, key = signed(site), site.subscribe("/lost", TOPIC)
    async with authority(site) as office, caller(site, EVE) as eve:
        assert (await office(DEPOSIT, [grant, key]))[2] == ["", ""]
        await revoke(site, witness, grant)
        assert await fetched(eve) == []
        reasons = (await office(DEPOSIT, [grant]))[2]
        assert "is revoked" in reasons[0]
        await revoke(site, witness, site.identity("/lost").thumbprint)
        holder = site.identity("/lost").thumbprint
        assert (await office(STATES, [document.grant_id(key) + holder]))[2] == [""]
        assert "is revoked" in (await office(DEPOSIT, [key]))[2][0]
    await witness.goes_on()


@pytest.mark.attack("delivery-of-a-withdrawn-grant")
async def test_a_node_refuses_what_a_stolen_master_delivers(
    site: Site, witness: Witness, caplog: pytest.LogCaptureFixture
) -> None:
    """The master carries grants; with its key nobody makes one, nor brings one back."""
    delivery = witness.viewer._membership._delivery
    home = site.enroll("/viewer")
    (own,) = home.grants()
    revoked = site.subscribe("/viewer", "/more")
    home.grant_file(document.grant_id(revoked)).unlink()
    await revoke(site, witness, revoked)
    foreign = Site(site.root.parent / "other")
    holder = site.identity("/viewer").thumbprint
    forged = foreign.grant("/viewer", Right(255), "/**", holder=holder)
    delivery.take({"grants": [forged, signed(site), revoked, b"noise"], "more": False})
    await delivery.save()
    assert caplog.text.count("a grant that the master delivers is refused") == 4
    assert home.grants() == [own]
    assert [held.token for held in witness.viewer.access.held_grants()] == [own]


@pytest.mark.attack("deposit-flood")
async def test_deposits_are_bounded_in_a_call_and_for_a_key(site: Site, witness: Witness) -> None:
    """Also with the key of `/ca` nobody fills the master: it is on the authority's host."""
    async with authority(site) as office:
        many = [signed(site) for _ in range(DEPOSIT_LIMIT + 1)]
        code, status, value = await office(DEPOSIT, many)
        assert (code, value) == (-1, [])
        assert "a list of at most 64" in status
        with pytest.raises(RossecError):
            await office(DEPOSIT, [bytes(5 << 20)])
    async with authority(site) as office:
        assert (await office(DEPOSIT, many[:-1]))[2] == [""] * MAX_HELD
        assert (await office(DEPOSIT, many[-1:]))[2] == ["the master takes at most 64 grants of one node"]
        twice = [{"methodName": DEPOSIT, "params": [AUTHORITY, []]}] * 2
        answers: Any = await office.client.call("system.multicall", twice)
        assert "more than one" in answers[1]["faultString"]
        answer: Any = await office(DEPOSIT, [site.publish("/robot", "/more")])
        assert answer[2] == [""], "other nodes are not affected"
    await witness.goes_on()


@pytest.mark.attack("deposit-flood")
async def test_calls_that_wait_are_bounded_by_the_connections_of_a_key(site: Site, witness: Witness) -> None:
    assert site.master is not None
    own, limit = credentials(site), MasterLimits().connections_without_right
    async with contextlib.AsyncExitStack() as stack:
        waiting: list[asyncio.Future[object]] = []
        for _ in range(limit):
            client = RpcClient(await dial(site.master.uri, own), deadline=60)
            stack.push_async_callback(client.close)
            waiting.append(asyncio.ensure_future(client.call(WATCH, EVE, b"")))
        await until(lambda: len(site_waits(site)) >= limit)
        stream = await dial(site.master.uri, own)
        with pytest.raises(ChannelError):
            await stream.receive()
        data = site.publish("/robot", "/more")
        async with authority(site) as office:
            assert (await office(DEPOSIT, [data]))[2] == [""]
            await until(lambda: site.enroll("/robot").grant_file(document.grant_id(data)).exists())
            assert not any(each.done() for each in waiting)
            assert (await office(DEPOSIT, [signed(site)]))[2] == [""]
        async with asyncio.timeout(30):
            await asyncio.gather(*waiting)
    await witness.goes_on()


def site_waits(site: Site) -> range:
    """One item for each call that waits at the master."""
    assert site.master is not None
    return range(len(site.master.state.grant_changes))

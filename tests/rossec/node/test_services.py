"""Services of nodes against a real master over real sockets: rights, revocation, restarts."""

import asyncio

import pytest

from grants.errors import GrantError
from grants.model import Right
from rossec.errors import AnswerMalformed, AnswerRefused, ConfigurationError, RossecError, ServiceUnavailable
from rossec.node import Node
from tests.support.lamp import BOOL, LAMP, called, switch
from tests.support.site import Site
from tests.support.witness import until


async def test_a_call_is_answered(lamp: Node, hall: Node) -> None:
    service = await lamp.service(LAMP, BOOL, switch)
    client = hall.client(LAMP, BOOL)
    response = await client(data=True)
    assert (response.success, response.message) == (True, "on is True")
    assert await called(client, data=False) == "on is False"
    assert (await client(client.create(data=True))).message == "on is True"
    await until(lambda: not service.links and not client.links)


async def test_service_names_are_resolved(site: Site, lamp: Node) -> None:
    await lamp.service("~on", BOOL, switch)
    site.grant("/hall", Right.CALL, LAMP)
    async with site.node("/hall", "light:=/lamp/on") as hall:
        assert await called(hall.client("light", BOOL), data=True) == "on is True"


async def test_invalid_arguments_are_refused(lamp: Node, hall: Node) -> None:
    await lamp.service(LAMP, BOOL, switch)
    with pytest.raises(ConfigurationError, match="provided by this node already"):
        await lamp.service(LAMP, BOOL, switch)
    for wrong in ({"concurrency": 0}, {"deadline": 0}):
        with pytest.raises(ConfigurationError, match="concurrency"):
            await lamp.service("/lamp/off", BOOL, switch, **wrong)
    with pytest.raises(ConfigurationError, match="deadline of 0 s"):
        hall.client(LAMP, BOOL, deadline=0)


async def test_a_call_without_a_provider_is_refused(lamp: Node, hall: Node) -> None:
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


async def test_a_caller_without_the_right_is_refused(site: Site, lamp: Node) -> None:
    await lamp.service(LAMP, BOOL, switch)
    site.enroll("/eve")
    async with site.node("/eve") as eve:
        with pytest.raises(AnswerRefused, match="call"):
            await eve.client(LAMP, BOOL)(data=True)
        with pytest.raises(AnswerRefused, match="call"):
            await eve.wait_for_service(LAMP, timeout=20)


async def test_a_provider_without_the_right_is_refused(site: Site, hall: Node) -> None:
    async with site.node("/eve") as eve:
        with pytest.raises(RossecError, match="provide"):
            await eve.service(LAMP, BOOL, switch)
        with pytest.raises(RossecError, match="provide"):  # the first attempt left no registration
            await eve.service(LAMP, BOOL, switch)


async def tell(site: Site, node: Node, revoked: bytes) -> None:
    await node._membership.session.call("rossec.updateRevocations", site.revoke(revoked))


async def test_the_connection_of_a_revoked_caller_is_closed(site: Site, lamp: Node) -> None:
    right = site.grant("/hall", Right.CALL, LAMP)
    service = await lamp.service(LAMP, BOOL, switch)
    async with site.node("/hall") as hall:
        client = hall.client(LAMP, BOOL, persistent=True)
        await called(client, data=True)
        assert len(service.links) == 1
        await tell(site, lamp, right)
        await until(lambda: not service.links and not client.links)
        await hall._membership.session._heartbeat()  # without registrations it learns of it by its heartbeat
        with pytest.raises((RossecError, GrantError)):
            await called(client, data=True)


async def test_the_connection_of_a_revoked_provider_is_closed(site: Site, hall: Node) -> None:
    right = site.grant("/lamp", Right.PROVIDE, LAMP)
    async with site.node("/lamp") as lamp:
        service = await lamp.service(LAMP, BOOL, switch)
        client = hall.client(LAMP, BOOL, persistent=True)
        await called(client, data=True)
        await tell(site, hall, right)
        await hall._membership.session._heartbeat()
        await until(lambda: not service.links and not client.links)


async def test_a_revoked_right_does_not_affect_other_registrations(
    site: Site, hall: Node, caplog: pytest.LogCaptureFixture
) -> None:
    revoked = site.grant("/lamp", Right.PROVIDE, "/lamp/off")
    site.grant("/lamp", Right.PROVIDE, LAMP)
    async with site.node("/lamp") as lamp:
        await lamp.service("/lamp/off", BOOL, switch)
        await lamp.service(LAMP, BOOL, switch)
        newest = site.revoke(revoked)
        await site.restart_master()
        await until(lambda: "/lamp/off is not registered again" in caplog.text)
        await until(lambda: hall.revocations.data == newest)  # it has connected to the new master
        await hall.wait_for_service(LAMP, timeout=20)
        with pytest.raises(ServiceUnavailable):
            await hall.client("/lamp/off", BOOL)(data=True)
        site.grant("/lamp", Right.PROVIDE, "/lamp/off")  # while it runs
        await hall.wait_for_service("/lamp/off", timeout=20)


async def test_the_known_services_and_their_providers(
    lamp: Node, hall: Node, monkeypatch: pytest.MonkeyPatch
) -> None:
    await lamp.service(LAMP, BOOL, switch)
    assert await hall.services.known() == {LAMP: ["/lamp"]}
    nonsenses: list[object] = [7, [[], []], [[], [], 7], [[], [], [7]], [[], [], [[LAMP, "x"]]]]
    for nonsense in nonsenses:

        async def answer(*_: object, value: object = nonsense) -> object:
            return value

        monkeypatch.setattr(hall._membership.session._client, "ask", answer)
        with pytest.raises(AnswerMalformed, match="an invalid system state"):
            await hall.services.known()


async def test_a_service_is_registered_again_with_a_restarted_master(
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


async def test_nothing_is_provided_below_remote(lamp: Node) -> None:
    with pytest.raises(ConfigurationError, match="cannot be provided here") as caught:
        await lamp.service("/remote/hospital/lamp", BOOL, switch)
    assert "take a name outside /remote" in caught.value.hint

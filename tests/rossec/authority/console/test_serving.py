"""The console's side put together: every operation has a handler, with or without a network."""

import time
from pathlib import Path

import pytest

from rossec.authority.console import serving as module
from rossec.authority.console.client import ConsoleClient
from rossec.authority.console.messages import PasskeyRegistration, Status, from_value
from rossec.authority.console.serving import Console, ConsolePlace, Deliveries
from rossec.authority.keyservice.messages import ServiceRequest
from rossec.authority.keyservice.process import AuditedCaller
from rossec.errors import KeyServiceRefused, NotDelivered
from tests.support.consolework import ConsoleWork
from tests.support.passkeys import ORIGIN, RP_ID, Passkey

CALLER = AuditedCaller(1, 2, "a test")


@pytest.fixture
def site(tmp_path: Path) -> ConsoleWork:
    return ConsoleWork(tmp_path)


@pytest.fixture
def console(site: ConsoleWork) -> Console:
    where = ConsolePlace(site.home.path / "console.sock")
    return Console(where, site.root, site.operations, None)


async def test_a_console_does_everything_in_the_table(console: Console) -> None:
    assert console.service.missing == frozenset()
    await console.service.close()


async def test_a_console_without_a_network_says_so(console: Console) -> None:
    with pytest.raises((NotDelivered, KeyServiceRefused)) as caught:
        await console.service.carry_out(ServiceRequest("graph"), CALLER)
    assert caught.value.hint
    status = from_value(Status, await console.service.carry_out(ServiceRequest("status"), CALLER))
    assert (status.locked, status.has_master) == (True, False)
    await console.service.close()


async def test_a_console_says_that_a_phone_waits(console: Console) -> None:
    await console.start()
    client, phone = ConsoleClient(console.where.path), Passkey()
    before = (await client.status()).number
    asked = await client.new_passkey(ORIGIN, RP_ID)
    answer = phone.register(asked.challenge)
    await client.propose_passkey(PasskeyRegistration(asked.id, await client.phone_link(), "p", *answer))
    assert (await client.status()).number != before
    await client.close()
    await console.close()


def test_deliveries_are_asked_while_there_is_a_master_and_not_every_time(
    site: ConsoleWork, monkeypatch: pytest.MonkeyPatch
) -> None:
    site.enroll("/doctor")
    number = site.grant("/doctor", 10**9)
    has_master, at = [False], [0.0]
    site.answers.append(["held"])
    monkeypatch.setattr(time, "monotonic", lambda: at[0])
    deliveries = Deliveries(site.work, lambda: has_master[0])
    assert deliveries.states() == {}
    has_master[0] = True
    assert deliveries.states() == deliveries.states() == {number: "held"}
    assert len(site.called) == 1
    at[0] += module.DELIVERIES_KEPT + 1
    assert deliveries.states() == {}

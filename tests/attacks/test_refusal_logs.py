"""A peer that is refused at wire speed: the log stays short."""

import contextlib

import pytest

from grants.model import Right
from rossec.errors import ServiceFailed
from tests.support.attacker import EVE
from tests.support.limited import HELD, ONE_MESSAGE, SERVICE, lamp, number
from tests.support.site import Site
from tests.support.witness import until


def logged_about_eve(caplog: pytest.LogCaptureFixture) -> list[str]:
    return [text for text in caplog.messages if EVE in text and ("withheld" in text or "refused" in text)]


@pytest.mark.attack("disk-filled-by-refusals")
async def test_malformed_messages_are_logged_once_a_minute(
    site: Site, caplog: pytest.LogCaptureFixture
) -> None:
    """Her right is restricted, so each of them is checked."""
    site.grant(EVE, Right.PUBLISH, "/orders", restriction=HELD)
    site.subscribe("/viewer", "/orders")
    async with site.node(EVE) as eve, site.node("/viewer") as viewer:
        heard = await viewer.subscriber("/orders", "std_msgs/Float64")
        publisher = await eve.publisher("/orders", "std_msgs/Float64", queue_size=1000)
        await publisher.wait_for_subscribers()
        for value in range(500):
            publisher.publish_bytes(bytes(1 + value % 7))
        publisher.publish_bytes(number(2))
        await until(lambda: heard.received == 1)
    assert 1 <= len(logged_about_eve(caplog)) < 5, "one in a minute"


@pytest.mark.attack("disk-filled-by-refusals")
async def test_a_caller_over_its_rate_is_logged_once_a_minute(
    site: Site, caplog: pytest.LogCaptureFixture
) -> None:
    calls: list[bool] = []
    site.grant(EVE, Right.CALL, SERVICE, restriction=ONE_MESSAGE)
    async with lamp(site, calls), site.node(EVE) as eve:
        client = eve.client(SERVICE, "std_srvs/SetBool", persistent=True)
        for _ in range(50):
            with contextlib.suppress(ServiceFailed):
                await client(data=True)
        await client.close()
    assert calls == [True]
    assert 1 <= len(logged_about_eve(caplog)) < 5, "one in a minute"

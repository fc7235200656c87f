"""A stolen identity for anonymous nodes: its wildcard covers no name outside its own prefix."""

from typing import Final

import pytest

from rossec.errors import ConnectionHeaderRefused
from rossec.ros.names import MASTER
from tests.support.attacker import EVE, call, credentials, expect_refused, fields_for, listen, send_header
from tests.support.site import Site
from tests.support.witness import POSE, TOPIC, Witness

OTHERS: Final = ["/robot", "/viewer", MASTER, "/ca", "/eve_", "/evex", "/eve_1/a", "/a/eve_1", "eve_1"]


@pytest.fixture
def eve(site: Site) -> Site:
    site.enroll(EVE, wildcard=True)
    site.subscribe(EVE, TOPIC)
    return site


@pytest.mark.attack("anonymous-tail")
async def test_a_certified_suffix_is_accepted(eve: Site, witness: Witness) -> None:
    fields = fields_for("/eve_1", TOPIC, eve.enroll(EVE).grants())
    heard = await send_header(witness.topic_port, credentials(eve), fields, at_most=1)
    assert "error" not in heard.fields


@pytest.mark.attack("anonymous-tail")
@pytest.mark.parametrize("name", OTHERS)
async def test_a_topic_under_another_name(
    eve: Site, witness: Witness, caplog: pytest.LogCaptureFixture, name: str
) -> None:
    listen(caplog)
    fields = fields_for(name, TOPIC, eve.enroll(EVE).grants())
    heard = await send_header(witness.topic_port, credentials(eve), fields)
    expect_refused(heard, caplog, ConnectionHeaderRefused, f"certified as {EVE} calls itself {name}")


@pytest.mark.attack("anonymous-tail")
async def test_a_suffix_without_a_certified_wildcard(
    site: Site, witness: Witness, caplog: pytest.LogCaptureFixture
) -> None:
    site.subscribe(EVE, TOPIC)
    fields = fields_for("/eve_1", TOPIC, site.enroll(EVE).grants())
    heard = await send_header(witness.topic_port, credentials(site), fields)
    expect_refused(heard, caplog, ConnectionHeaderRefused, f"certified as {EVE} calls itself /eve_1")


@pytest.mark.attack("anonymous-tail")
@pytest.mark.parametrize("name", OTHERS)
async def test_the_master_and_slave_apis_under_another_name(eve: Site, witness: Witness, name: str) -> None:
    assert eve.master is not None
    uri, own = eve.master.uri, credentials(eve)
    for method, *params in (
        ("unregisterPublisher", TOPIC, witness.robot.uri),
        ("registerSubscriber", TOPIC, POSE, "http://127.0.0.1:1/"),
    ):
        answer = await call(uri, own, method, name, *params)
        assert isinstance(answer, list)
        assert answer[0] == -1
        assert answer[1] == f"rossec: this connection belongs to {EVE}, it cannot act as another"
    asked = await call(witness.robot.uri, own, "requestTopic", name, TOPIC, [["TCPROS"]])
    assert asked == [-1, f"rossec: caller_id is not {EVE}", []]
    steered = await call(witness.robot.uri, own, "shutdown", name, "bye")
    assert steered == [-1, "rossec: shutdown is for the master alone", 0]


@pytest.mark.attack("anonymous-tail")
async def test_the_address_of_another_node(eve: Site, witness: Witness) -> None:
    """One node of a wildcard may not claim the address of another that is registered."""
    assert eve.master is not None
    uri, own = eve.master.uri, credentials(eve)
    await call(uri, own, "rossec.presentGrants", EVE, eve.enroll(EVE).grants())
    subscribe = "registerSubscriber", "/eve_1", TOPIC, POSE
    stolen = await call(uri, own, *subscribe, witness.robot.uri)
    assert stolen == [-1, "rossec: this address is registered by another node", []]

"""What an enrolled node without a right could learn if answers differed (N4, N5).

The built-in node's and rospy's are in `test_unauthorized_peers` and `test_rospy_api`.
"""

from collections.abc import AsyncIterator
from typing import Any

import pytest

from grants.model import Right
from rossec.channel.opening import WireProtocol
from rossec.sidecar.server import Sidecar
from tests.rossec.sidecar.program import Program, sidecar
from tests.support.attacker import EVE, HOST, call, credentials, send_header
from tests.support.caller import caller
from tests.support.site import Site
from tests.support.witness import Witness

THERE, ABSENT, SERVICE = "/robot2/word", "/robot2/none", "/robot2/say"
T = "std_msgs/String"


@pytest.fixture
async def near(site: Site) -> AsyncIterator[Sidecar]:
    site.publish("/robot2", THERE)
    site.grant("/robot2", Right.PROVIDE, SERVICE)
    async with sidecar(site) as near:
        yield near


@pytest.fixture
async def robot(near: Sidecar) -> AsyncIterator[Program]:
    """A program that answers as stock ones: only for what it publishes."""
    async with Program("/robot2", near, published={THERE}) as robot:
        await robot.register("registerPublisher", THERE, T)
        where = f"rosrpc://{HOST}:{robot.topics.port}"
        await robot.register("registerService", SERVICE, where)
        robot.calls.clear()
        yield robot


def ports(near: Sidecar, protocol: WireProtocol) -> list[int]:
    """The ports of /robot2 on the network."""
    exports = near._agent_for("/robot2")._ingress.ports
    return [public.port for place, public in exports._ports.items() if place.protocol is protocol]


async def offered(site: Site, near: Sidecar, topic: object) -> Any:
    [port] = ports(near, WireProtocol.HTTP)
    uri = f"http://{HOST}:{port}/"
    return await call(uri, credentials(site), "requestTopic", EVE, topic, [["TCPROS"]])


@pytest.mark.attack("existence-oracle")
async def test_a_sidecar_answers_alike_for_every_topic(
    site: Site, near: Sidecar, robot: Program, witness: Witness
) -> None:
    """The program, whose answers differ, is not called."""
    answers = [await offered(site, near, topic) for topic in (THERE, ABSENT, "no name")]
    assert answers[0][:2] == [1, "ready"]
    assert answers == answers[:1] * 3
    assert robot.calls == []


@pytest.mark.attack("existence-oracle")
async def test_a_header_without_a_grant_is_refused_alike(
    site: Site, near: Sidecar, robot: Program, witness: Witness
) -> None:
    """At the topics' port and at the services'."""
    await offered(site, near, THERE)
    for port in ports(near, WireProtocol.TCPROS):
        for kind, there in (("topic", THERE), ("service", SERVICE)):
            said = set()
            for name in (there, ABSENT):
                asked = {"callerid": EVE, kind: name, "type": "*", "md5sum": "*", "probe": "1"}
                said.add((await send_header(port, credentials(site), asked)).error.replace(name, "X"))
            assert len(said) == 1, said
    assert (robot.calls, robot.headers) == ([], [])


@pytest.mark.attack("existence-oracle")
async def test_with_the_right_the_answer_differs(site: Site, near: Sidecar, robot: Program) -> None:
    """The control: an existing topic is answered."""
    site.subscribe("/ear", THERE)
    site.subscribe("/ear", ABSENT)
    async with sidecar(site) as far, Program("/ear", far) as ear:
        uris = await ear.register("registerSubscriber", THERE, T)
        assert isinstance(uris, list)
        stream, answer = await ear.subscribe(uris[0], THERE)
        assert answer["md5sum"]
        await stream.close()
        _, answer = await ear.subscribe(uris[0], ABSENT)
        assert b"/robot2 does not publish /robot2/none" in answer["error"]


@pytest.mark.parametrize(
    ("method", "params"),
    [
        ("registerPublisher", ("/t", T)),
        ("registerSubscriber", ("/t", T)),
        ("registerService", ("/t", "rosrpc://127.0.0.1:9")),
        ("subscribeParam", ()),
    ],
)
@pytest.mark.attack("existence-oracle")
async def test_the_master_does_not_say_which_addresses_are_nodes(
    site: Site, witness: Witness, method: str, params: tuple[str, ...]
) -> None:
    """It does not call the address for a caller that may not register at all."""
    async with caller(site, EVE) as eve:
        said = set()
        for uri in (witness.robot.uri, "http://127.0.0.1:9/", eve.uri):
            asked = (uri, "/t") if method == "subscribeParam" else (*params, uri)
            said.add(await eve.refused(method, *asked))
    assert len(said) == 1, said

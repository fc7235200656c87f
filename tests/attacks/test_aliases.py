"""Names below /remote on the wire: asked for, answered with, offered, in each form of a node.

The attacker holds every right of its domain; an alias is no name on a wire all the same.
"""

from collections.abc import AsyncIterator, Mapping
from pathlib import Path
from typing import Any, Final

import pytest

from ca.encoding import encode
from grants.model import Right
from rossec.channel.opening import WireProtocol
from rossec.errors import ConnectionHeaderRefused
from rossec.participant.access import FIELD
from rossec.sidecar.server import Sidecar
from tests.attacks.test_existence import ports
from tests.attacks.test_impostors import answer, impostor, led
from tests.rossec.sidecar.program import Program, sidecar
from tests.support.attacker import EVE, HOST, call, credentials, send_header, signed
from tests.support.site import Site
from tests.support.victim import STATE, attacked
from tests.support.witness import TOPIC, Witness

ALIAS: Final = f"/remote/hospital{TOPIC}"
RIGHTS: Final = Right.SUBSCRIBE | Right.CALL | Right.PUBLISH | Right.PROVIDE


def header_for(site: Site, kind: str, name: str) -> Mapping[str, str | bytes]:
    grants = [site.grant(EVE, RIGHTS, "/**")]
    return {
        "callerid": EVE,
        kind: name,
        "type": "*",
        "md5sum": "*",
        "probe": "1",
        FIELD: encode(list(grants)),
    }


async def check_refused(site: Site, uri: str, port: int) -> None:
    """Neither at the API nor in a connection header, with every right."""
    answered: Any = await call(uri, credentials(site), "requestTopic", EVE, ALIAS, [["TCPROS"]])
    assert answered[0] == -1
    assert "asked by the origin's name" in answered[1]
    for kind in ("topic", "service"):
        said = await send_header(port, credentials(site), header_for(site, kind, ALIAS))
        assert "no name on the wire" in said.error


@pytest.mark.attack("alias-on-wire")
async def test_the_built_in_node_refuses_an_alias(site: Site, witness: Witness) -> None:
    await check_refused(site, witness.robot.uri, witness.topic_port)


@pytest.mark.ros
@pytest.mark.attack("alias-on-wire")
async def test_rospy_refuses_an_alias(tmp_path: Path) -> None:
    async with attacked(tmp_path) as victim:
        await check_refused(victim.site, victim.uri, victim.port)
        fields = header_for(victim.site, "topic", STATE)
        assert "callerid" in (await send_header(victim.port, credentials(victim.site), fields, 1)).fields
        await victim.goes_on()


@pytest.fixture
async def near(site: Site) -> AsyncIterator[Sidecar]:
    site.publish("/robot2", "/**")
    site.grant("/robot2", Right.PROVIDE | Right.PARAM_SET, "/**")
    async with sidecar(site) as near:
        yield near


@pytest.mark.attack("alias-on-wire")
async def test_a_sidecar_refuses_an_alias_and_asks_no_program(
    site: Site, near: Sidecar, witness: Witness
) -> None:
    async with Program("/robot2", near) as robot:
        await robot.register("registerPublisher", "/robot2/word", "std_msgs/String")
        [api] = ports(near, WireProtocol.HTTP)
        offer: Any = await call(
            f"http://{HOST}:{api}/", credentials(site), "requestTopic", EVE, TOPIC, [["TCPROS"]]
        )
        robot.calls.clear()
        uri, name = f"http://{HOST}:{api}/", header_for(site, "topic", ALIAS)
        answered: Any = await call(uri, credentials(site), "requestTopic", EVE, ALIAS, [["TCPROS"]])
        assert answered[0] == -1
        said = await send_header(offer[2][2], credentials(site), name)
        assert "no name on the wire" in said.error
        assert (robot.calls, robot.headers) == ([], [])


@pytest.mark.attack("alias-on-wire")
async def test_a_program_with_every_right_offers_nothing_below_remote(
    site: Site, near: Sidecar, witness: Witness
) -> None:
    async with Program("/robot2", near) as robot:
        where = f"rosrpc://{HOST}:{robot.topics.port}"
        for method, more in (("registerPublisher", "std_msgs/String"), ("registerService", where)):
            with pytest.raises(AssertionError, match="names below /remote are those of other"):
                await robot.register(method, ALIAS, more)


@pytest.mark.attack("alias-on-wire")
async def test_a_publisher_that_answers_with_an_alias_is_refused(site: Site, witness: Witness) -> None:
    own, grants = credentials(site), [signed(site, right=Right.PUBLISH)]
    async with impostor(own, answer(grants, topic=ALIAS)) as uri:
        refused = await led(site, witness, uri)
    assert isinstance(refused, ConnectionHeaderRefused)
    assert "answers with another topic" in str(refused)

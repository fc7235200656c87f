"""Values of a wrong type, in files and in calls: each is refused with an error of ours.

What is behind a signature is signed here by the authority, as if it had made a mistake.
"""

import asyncio
import contextlib
import itertools
import logging
from collections.abc import Iterator
from typing import Any, Final

import pytest

from ca.encoding import encode
from grants.document import GRANT
from grants.model import Restriction, Right, filter_rules
from rossec.master.rights.access_rules import RULES
from rossec.net.rpc.calls import RpcClient
from rossec.participant.slave_api import RULES as SLAVE_RULES
from rossec.ros.xmlrpc import Fault
from tests.fuzz.mutants import dumps, mutants
from tests.fuzz.statements import seal
from tests.support.attacker import EVE, credentials, dial, fields_for, send_header, signed
from tests.support.site import Site
from tests.support.witness import TOPIC, Witness, until

pytestmark = pytest.mark.timeout(300)
ANY: Final = Restriction("geometry_msgs/PoseStamped", (), filter_rules({"header": {"clear": True}}))
VALUES: Final[tuple[object, ...]] = (
    0,
    -1,
    2**31 - 1,
    1.5,
    "",
    "x",
    "/x",
    "/**",
    "\u202e",
    "x" * 3000,
    b"",
    b"\xa0",
    bytes(32),
    True,
    [],
    [0],
    [[]],
    [["TCPROS"]],
    ["x", b"", 0],
    {},
    {"x": [1]},
    {"": {}},
)
TEMPLATES: Final[dict[str, tuple[object, ...]]] = {
    "registerPublisher": (TOPIC, "std_msgs/String", "http://127.0.0.1:9/"),
    "registerSubscriber": (TOPIC, "std_msgs/String", "http://127.0.0.1:9/"),
    "registerService": ("/serve", "rosrpc://127.0.0.1:9", "http://127.0.0.1:9/"),
    "unregisterPublisher": (TOPIC, "http://127.0.0.1:9/"),
    "unregisterSubscriber": (TOPIC, "http://127.0.0.1:9/"),
    "unregisterService": ("/serve", "rosrpc://127.0.0.1:9"),
    "subscribeParam": ("http://127.0.0.1:9/", "/speed"),
    "unsubscribeParam": ("http://127.0.0.1:9/", "/speed"),
    "setParam": ("/speed", 1),
}


def strange(template: tuple[object, ...]) -> Iterator[tuple[object, ...]]:
    """One argument of another type, one missing, one too many."""
    yield ()
    yield (*template, 0, 0)
    for place, value in itertools.product(range(len(template)), VALUES):
        yield (*template[:place], value, *template[place + 1 :])


def crashes(caplog: pytest.LogCaptureFixture) -> list[logging.LogRecord]:
    """What was logged with a traceback."""
    return [record for record in caplog.records if record.exc_info]


async def answered(client: RpcClient, method: str, *params: object) -> None:
    """An answer of the API, or a fault that says why; the connection goes on."""
    with contextlib.suppress(Fault):
        answer = await client.call(method, *params)
        match answer:
            case [int(), str(), *_]:
                pass
            case _:
                raise AssertionError(f"{method}{params}: {answer}")


@pytest.mark.attack("wrong-types")
async def test_the_master_answers_every_type(
    site: Site, witness: Witness, caplog: pytest.LogCaptureFixture
) -> None:
    """From a caller with every right, so that nothing is refused before it is parsed."""
    for right in Right:
        site.grant(EVE, right, "/**")
    assert site.master is not None
    stream = await dial(site.master.uri, credentials(site))
    client = RpcClient(stream)
    await client.call("rossec.presentGrants", EVE, site.enroll(EVE).grants())
    for method in sorted(RULES.keys() - {"shutdown", "rossec.presentGrants"}):
        for params in strange(TEMPLATES.get(method, ("/speed", "/x", 0))):
            await answered(client, method, EVE, *params)
        for caller in VALUES:
            await answered(client, method, caller, *TEMPLATES.get(method, ("/speed",)))
    for params in strange(([b"grant"],)):
        await answered(client, "rossec.presentGrants", EVE, *params)
    for params in strange(([{"methodName": "getParam", "params": [EVE, "/x"]}],)):
        with contextlib.suppress(Fault):
            await client.call("system.multicall", *params)
    calls: tuple[object, ...] = (
        {"methodName": 1},
        {"methodName": "getPid", "params": {}},
        {"params": []},
        7,
        [],
    )
    for call in calls:
        with contextlib.suppress(Fault):
            await client.call("system.multicall", [call])
    await stream.close()
    assert crashes(caplog) == []
    await witness.goes_on()


@pytest.mark.attack("wrong-types")
@pytest.mark.parametrize("caller", [EVE, "/master"])
async def test_a_node_answers_every_type(
    site: Site, witness: Witness, caplog: pytest.LogCaptureFixture, caller: str
) -> None:
    """Also from a faulty master."""
    stream = await dial(witness.viewer.uri, credentials(site, caller))
    client = RpcClient(stream)
    for method in sorted(SLAVE_RULES.keys() - {"shutdown"}):
        template = ("/nothing", ["http://127.0.0.1:9/"], b"x")[: len(SLAVE_RULES[method].kinds)]
        for params in strange(template):
            if params[:1] != (TOPIC,):
                await answered(client, method, caller, *params)
    await stream.close()
    assert crashes(caplog) == []
    await witness.goes_on()


def odd_grants(site: Site) -> list[bytes]:
    """A grant with one thing in its restriction changed, each under a good signature."""
    claims: Any = GRANT.peek(signed(site))
    scope = [[TOPIC, 2, {0: ANY.type, 2: {"header": {"clear": True}}, 3: {"rate": 1}}]]
    changed = (dumps({**claims, 9: dumps(value)}) for value in mutants(scope))
    return [seal(GRANT, site.authority.signer, body) for body in changed if len(body) < 8000]


@pytest.mark.attack("wrong-types")
async def test_a_node_parses_every_presented_grant(
    site: Site, witness: Witness, caplog: pytest.LogCaptureFixture
) -> None:
    for grant in odd_grants(site)[::7]:
        fields = fields_for(EVE, TOPIC, [grant])
        await send_header(witness.topic_port, credentials(site), fields, at_most=1)
    assert crashes(caplog) == []
    await witness.goes_on()


@pytest.mark.attack("wrong-types")
async def test_a_node_parses_every_file_among_its_grants(
    site: Site, caplog: pytest.LogCaptureFixture
) -> None:
    """It starts, runs, and names each invalid file."""
    site.publish("/robot", TOPIC)
    place = site.enroll("/robot").path / "grants"
    odd = odd_grants(site)
    assert len(odd) > 500
    for number, data in enumerate(odd):
        (place / f"early{number}.grant").write_bytes(data)
    (place / "folder.grant").mkdir()
    async with site.node("/robot") as robot:
        await robot.publisher(TOPIC, "geometry_msgs/PoseStamped")
        assert "folder.grant cannot be read" in caplog.text
        assert "early0.grant is not a valid grant" in caplog.text
        claims: Any = GRANT.peek(signed(site))
        text = encode({**claims, 9: encode([[TOPIC, 2, {0: "a/B", 2: {7: {"clear": True}}}]])})
        (place / "late.grant").write_bytes(seal(GRANT, site.authority.signer, text))
        await until(lambda: "late.grant is not a valid grant" in caplog.text, within=30)
        later = site.publish("/robot", "/robot/later")
        await until(lambda: later in robot._membership._grant_directory._seen, within=30)
        await robot.publisher("/robot/later", "std_msgs/String")
        with pytest.raises(TimeoutError):
            async with asyncio.timeout(0.1):
                await robot.wait_ended()
    assert crashes(caplog) == []

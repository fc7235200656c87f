"""A gateway between two domains on two hosts, with everything as processes.

The robot's site grants the gateway of the house, which alone has a right there. What the house's
nodes get is the house's decision; how precise it is, the robot's.
"""

import asyncio
import signal
import time
from collections.abc import AsyncIterator
from typing import Any, Final

import pytest
import pytest_asyncio

from grants.model import Restriction, Right, filter_rules
from tests.support.crewprocess import CrewProcess, NotDone
from tests.support.gatewayprocess import GatewayProcess, gateway_of
from tests.support.mesh import Mesh, mesh_of
from tests.support.trust import accept, carry, share
from tests.support.witness import until

pytestmark = pytest.mark.asyncio(loop_scope="module")
POSE, MAP, SECRET, TEXT = "/robot/pose", "/robot/map", "/robot/secret", "/robot/text"
FORWARDED_PORT: Final = "/robot/door"
HERE: Final = "/remote/ada"
SERVED: Final = "/gateway/ada"
TYPE: Final = "std_msgs/String"
CUT: Final = 2.0  # seconds; a loaded machine is slow
LISTENERS: Final = ("/tablet", "/screen", "/phone")


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def world(tmp_path_factory: pytest.TempPathFactory) -> AsyncIterator[Mesh]:
    """Both sites, following each other; the robot publishes."""
    async with mesh_of({"ada": ("robot",), "ben": ("house",)}, tmp_path_factory.mktemp("w")) as mesh:
        enroll(mesh)
        await asyncio.gather(*(each.begin("--admin", shortened=True) for each in mesh.places.values()))
        mesh["house"].follow(mesh["robot"], "ada")
        mesh["robot"].follow(mesh["house"], "ben")
        await mesh["robot"].crew.publish("/robot", POSE, SECRET, TEXT)
        yield mesh


def enroll(mesh: Mesh) -> None:
    ada, ben = mesh.domains["ada"], mesh.domains["ben"]
    accept(ada.site, ben.site, admitted=("/gateway", "/gateway/*", "/master", "/phone"))
    accept(ben.site, ada.site, admitted=("/robot", "/robot/*", "/master"))
    ada.enroll("/robot", publish=f"{POSE} {SECRET} {TEXT}")
    ada.enroll("/robot/eyes", publish=f"{MAP} {FORWARDED_PORT}")
    ada.enroll("/robot/ears", publish=MAP)
    for name in ("/gateway", "/gateway/attic"):
        ben.enroll(name, publish=f"{SERVED}/**", graph="/master")
        ada.invite(ben, name, subscribe=f"{POSE} {MAP} {FORWARDED_PORT}")
        rules = filter_rules({"data": {"truncate": {"length": 1}}})
        share(ada.site, ben.site, name, Right.SUBSCRIBE, TEXT, Restriction(TYPE, (), rules))
    ada.invite(ben, "/master", graph="/**")
    for name in LISTENERS:
        ben.enroll(name, subscribe=f"{SERVED}{POSE} {SERVED}{MAP} {SERVED}{TEXT} {SERVED}{FORWARDED_PORT}")
    ben.enroll("/curious", subscribe=f"{SERVED}/**")
    for domain in mesh.domains.values():
        carry(domain.site)


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def gateway(world: Mesh) -> AsyncIterator[GatewayProcess]:
    async with gateway_of(world["house"], "--from", "ada", "/robot/**") as made:
        yield made


def house(world: Mesh) -> CrewProcess:
    return world["house"].crew


async def subscribe(world: Mesh, node: str, topic: str) -> None:
    """Subscribe as soon as the topic is there for `node`, and receive a message."""
    await house(world).subscribe(node, HERE + topic)
    await house(world).hears(node, HERE + topic)


async def links(world: Mesh, node: str, topic: str) -> int:
    """How many subscribers a publisher of the robot has."""
    found = await world["robot"].crew.do(node, "links", topic)
    assert isinstance(found, int)
    return found


async def test_the_last_latched_message_arrives_in_spite_of_a_rate(world: Mesh) -> None:
    """A publisher that thins out would keep it back; so the gateway does, and sends it later."""
    robot, heard = world["robot"].crew, house(world).heard["/tablet", HERE + FORWARDED_PORT]
    rules = ("--from", "ada", FORWARDED_PORT, "--rate", "1", "--compress")
    async with gateway_of(world["house"], *rules, name="/gateway/attic"):
        await robot.do("/robot/eyes", "say", FORWARDED_PORT, "shut")
        await house(world).subscribe("/tablet", HERE + FORWARDED_PORT)
        await until(lambda: heard == ["shut"], within=40)
        for state in ("ajar", "wide", "open"):
            await robot.do("/robot/eyes", "say", FORWARDED_PORT, state)
        await until(lambda: heard[-1] == "open")
        assert len(heard) <= 3
        await house(world).do("/tablet", "leave")


async def test_all_of_the_house_are_one_subscriber_of_the_robot(world: Mesh, gateway: GatewayProcess) -> None:
    for name in LISTENERS:
        await subscribe(world, name, POSE)
    assert await links(world, "/robot", POSE) == 1
    (row,) = [each for each in (await gateway.status())["topics"] if each["subscribers"]]
    assert (row["topic"], row["subscribers"], row["publishers"]) == (f"ada:{POSE}", 3, 1)
    assert row["type"] == TYPE


async def test_what_the_robot_does_not_grant_the_gateway_nobody_gets(
    world: Mesh, gateway: GatewayProcess
) -> None:
    with pytest.raises(NotDone, match="needs the right subscribe"):
        await house(world).subscribe("/tablet", HERE + SECRET)
    await house(world).subscribe("/curious", HERE + SECRET)
    await subscribe(world, "/curious", POSE)
    assert house(world).heard["/curious", HERE + SECRET] == []
    await house(world).do("/curious", "leave")
    assert f"ada:{SECRET}" not in {row["topic"] for row in (await gateway.status())["topics"]}


async def test_the_filters_of_the_gateways_grant_hold_for_everybody_behind_it(
    world: Mesh, gateway: GatewayProcess
) -> None:
    for name in LISTENERS[:2]:
        await subscribe(world, name, TEXT)
    await until(lambda: len(house(world).heard["/tablet", HERE + TEXT]) > 20)
    for name in LISTENERS[:2]:
        assert {len(text) for text in house(world).heard[name, HERE + TEXT]} == {1}
    await world["robot"].crew.do("/robot", "links", TEXT)
    assert await links(world, "/robot", TEXT) == 1


async def test_a_late_subscriber_is_sent_what_is_latched(world: Mesh, gateway: GatewayProcess) -> None:
    robot, heard = world["robot"].crew, house(world).heard
    await robot.do("/robot/eyes", "say", MAP, "old")
    await robot.do("/robot/eyes", "say", MAP, "kitchen")
    await house(world).subscribe("/tablet", HERE + MAP)
    await until(lambda: heard["/tablet", HERE + MAP] == ["kitchen"])
    await house(world).subscribe("/screen", HERE + MAP)
    await until(lambda: heard["/screen", HERE + MAP] == ["kitchen"])
    await robot.do("/robot/ears", "say", MAP, "noise")
    await until(lambda: heard["/screen", HERE + MAP] == ["kitchen", "noise"])
    await house(world).subscribe("/phone", HERE + MAP)
    await until(lambda: sorted(heard["/phone", HERE + MAP]) == ["kitchen", "noise"])
    assert await links(world, "/robot/eyes", MAP) == 1


async def test_the_origin_is_left_when_nobody_listens(world: Mesh, gateway: GatewayProcess) -> None:
    for name in LISTENERS:
        await house(world).do(name, "leave")
    async with asyncio.timeout(40):
        while await links(world, "/robot", POSE):  # noqa: ASYNC110 - asking
            await asyncio.sleep(0.2)
    await subscribe(world, "/tablet", POSE)
    await subscribe(world, "/screen", POSE)


async def test_a_gateway_that_is_killed_serves_again_by_itself(world: Mesh, gateway: GatewayProcess) -> None:
    for number in (signal.SIGKILL, signal.SIGTERM):
        await gateway.kill(number)
        await house(world).falls_silent("/tablet", HERE + POSE)
        await gateway.start()
        for name in LISTENERS[:2]:
            await house(world).hears(name, HERE + POSE, within=60)
    assert await links(world, "/robot", POSE) == 1


async def test_the_master_is_killed_and_comes_back(world: Mesh, gateway: GatewayProcess) -> None:
    since = time.time()
    await world["house"].kill()
    await asyncio.sleep(3)
    await world["house"].start()
    await asyncio.sleep(3)
    assert house(world).longest_gap("/tablet", HERE + POSE, since) < CUT
    await subscribe(world, "/phone", POSE)
    assert await links(world, "/robot", POSE) == 1


async def test_the_origin_is_killed_and_comes_back(world: Mesh, gateway: GatewayProcess) -> None:
    robot = world["robot"]
    await robot.crew.close()
    await robot.kill()
    await robot.start()
    robot._crew = await CrewProcess.started(robot.host.prefix, robot.environ, robot.directory / "crew.log")
    await robot.crew.publish("/robot", POSE, SECRET, TEXT)
    for name in LISTENERS:
        await house(world).hears(name, HERE + POSE, within=60)


async def test_a_second_gateway_serves_when_the_first_is_gone(world: Mesh, gateway: GatewayProcess) -> None:
    rules = ("--from", "ada", POSE)
    async with gateway_of(world["house"], *rules, name="/gateway/attic") as second:
        await says(second, "/gateway serves it")
        await gateway.kill()
        for name in LISTENERS:
            await house(world).hears(name, HERE + POSE, within=60)
        await until_served(second)
        await gateway.start()
        await says(gateway, "/gateway/attic serves it")
    for name in LISTENERS:
        await house(world).hears(name, HERE + POSE, within=60)


async def test_a_gateway_that_hangs_is_replaced_until_it_goes_on(
    world: Mesh, gateway: GatewayProcess
) -> None:
    rules = ("--from", "ada", POSE)
    async with gateway_of(world["house"], *rules, name="/gateway/attic") as second:
        await says(second, "/gateway serves it")
        with gateway.paused():
            for name in LISTENERS:
                await house(world).falls_silent(name, HERE + POSE)
            for name in LISTENERS:
                await house(world).hears(name, HERE + POSE, within=60)
        await says(second, "/gateway serves it")
    for name in LISTENERS:
        await house(world).hears(name, HERE + POSE, within=60)
    assert await links(world, "/robot", POSE) == 1


async def says(gateway: GatewayProcess, why: str) -> None:
    """Wait until its status gives this reason for the pose."""
    async with asyncio.timeout(40):
        while True:
            skipped: list[dict[str, Any]] = (await gateway.status())["skipped"]
            if (f"ada:{POSE}", why) in {(row["topic"], row["why"]) for row in skipped}:
                return
            await asyncio.sleep(0.2)


async def until_served(gateway: GatewayProcess) -> None:
    async with asyncio.timeout(40):
        while not (await gateway.status())["topics"]:  # noqa: ASYNC110 - asking
            await asyncio.sleep(0.2)


async def test_a_gateway_whose_grant_is_revoked_stops_at_once(world: Mesh, gateway: GatewayProcess) -> None:
    """The list is given to the robot's master; the last message is that at the house's nodes."""
    ada, ben = world.domains["ada"], world.domains["ben"]
    key = ben.site.identity("/gateway").thumbprint
    revoked, given = ada.site.revoke(key), time.time()
    await world["robot"].deliver("rossec.updateRevocations", revoked)
    for name in LISTENERS:
        last = await house(world).falls_silent(name, HERE + POSE)
        assert last - given < CUT
    await says_revoked(gateway)


async def says_revoked(gateway: GatewayProcess) -> None:
    async with asyncio.timeout(40):
        while any(row["publishers"] for row in (await gateway.status())["topics"]):  # noqa: ASYNC110
            await asyncio.sleep(0.2)

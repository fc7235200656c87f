"""Two masters on two hosts that find each other: nothing is configured, multicast is real."""

import asyncio
import time
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Final

import pytest

from tests.support.mesh import Mesh, mesh_of
from tests.support.trust import carry

POSE, HEAT = "/robot/pose", "/kitchen/heat"
FOUND: Final = 30.0  # seconds; they announce themselves each second, and a loaded machine is slow


@pytest.fixture
async def two(short_path: Path) -> AsyncIterator[Mesh]:
    async with mesh_of({"home": ("hall", "kitchen")}, short_path) as mesh:
        home = mesh.domains["home"]
        home.enroll("/robot", publish=POSE)
        home.enroll("/viewer", subscribe=HEAT)
        home.enroll("/cook", publish=HEAT, subscribe=POSE)
        carry(home.site)  # the list that names both masters' keys
        options = "--announce", "--follow-announced", "--admin"
        await asyncio.gather(*(place.begin(*options) for place in mesh.places.values()))
        yield mesh


async def test_masters_that_hear_each_other_follow_each_other(two: Mesh) -> None:
    """Nodes of both hear each other; those of the kitchen have `ROSSEC_MASTER=/master/kitchen`."""
    hall, kitchen = two["hall"], two["kitchen"]
    assert kitchen.environ["ROSSEC_MASTER"] == "/master/kitchen"
    await hall.crew.publish("/robot", POSE)
    await kitchen.crew.publish("/cook", HEAT)
    await hall.crew.subscribe("/viewer", HEAT)
    await kitchen.crew.subscribe("/cook", POSE)
    async with asyncio.timeout(FOUND):
        await hall.crew.hears("/viewer", HEAT)
        await kitchen.crew.hears("/cook", POSE)
    for place, label, master in ((hall, "kitchen", "/master/kitchen"), (kitchen, "master", "/master")):
        found = (await place.sites())[label]
        assert (found["state"], found["source"]) == ("following", "announced")
        assert found["master"] == master
    revoked = two.domains["home"].site.revoke(two.domains["home"].site.identity("/robot").thumbprint)
    given = time.time()
    await kitchen.deliver("rossec.updateRevocations", revoked)  # it published at the other one
    assert await kitchen.crew.falls_silent("/cook", POSE) - given < 2

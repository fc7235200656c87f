"""A master that is followed, and lies: `tests.support.lyingsite` on another host, as a process."""

import asyncio
import contextlib
import json
import sys
from collections.abc import AsyncIterator
from typing import Any, Final

import pytest
import pytest_asyncio

from rossec.home import NodeHome
from rossec.saved_statements import DomainFiles
from tests.support.mesh import Mesh, mesh_of
from tests.support.trust import accept, carry
from tests.support.witness import until

pytestmark = pytest.mark.asyncio(loop_scope="module")
POSE: Final = "/robot/pose"


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def mesh(tmp_path_factory: pytest.TempPathFactory) -> AsyncIterator[Mesh]:
    """A home with an honest pair, and a hospital whose master's place is the liar's."""
    root = tmp_path_factory.mktemp("liar")
    async with mesh_of({"home": ("hall",), "hospital": ("ward",)}, root) as mesh:
        home, hospital = mesh.domains["home"], mesh.domains["hospital"]
        accept(home.site, hospital.site, admitted=("/rounds/**", "/master"))
        home.enroll("/robot", publish=POSE)
        home.enroll("/viewer", subscribe=POSE)
        hospital.enroll("/rounds/robot3")
        carry(home.site)
        hall = mesh["hall"]
        await hall.begin("--admin")
        await hall.crew.publish("/robot", POSE)
        await hall.crew.subscribe("/viewer", POSE)
        await hall.crew.hears("/viewer", POSE)
        yield mesh


@contextlib.asynccontextmanager
async def lying(mesh: Mesh, name: str = "/master", **lies: object) -> AsyncIterator[None]:
    """A liar with the identity of `name`, which the hall follows."""
    hall, ward = mesh["hall"], mesh["ward"]
    known = {"list": str(mesh.root / "list"), **lies}
    newest = mesh.domains["hospital"].site.authority.store.newest_list()
    (mesh.root / "list").write_bytes(newest or b"")
    process = await asyncio.create_subprocess_exec(
        *ward.host.at(sys.executable, "-m", "tests.support.lyingsite", name, json.dumps(known)),
        env=ward.environ,
        stdout=asyncio.subprocess.PIPE,
    )
    assert process.stdout is not None
    try:
        async with asyncio.timeout(30):
            assert await process.stdout.readline()
        hall.follow(ward, "hospital")
        yield
    finally:
        process.kill()
        await process.wait()
        hall.unfollow("hospital")


async def said(mesh: Mesh, words: str) -> None:
    """Wait until the hall's master has logged `words`, after what it said before this test."""
    before = mesh["hall"].said().count(words)
    await until(lambda: mesh["hall"].said().count(words) > before)


async def names(mesh: Mesh) -> list[str]:
    """The topics that the hall's master shows."""
    state: Any = await mesh["hall"].see()
    return [topic for topic, _ in state[0]]


@pytest.mark.attack("lying-site")
async def test_addresses_that_mean_another_machine_here_are_not_taken(mesh: Mesh) -> None:
    """Loopback, link-local, that of an own node; an ordinary one is."""
    own: Any = await mesh["hall"].see("lookupNode", "/robot")
    uris = {
        "loop": "http://127.0.0.1:11311/",
        "link": "http://169.254.1.1:4242/",
        "own": own,
        "far": "http://10.98.0.9:4242/",
    }
    facts = [["node", f"/rounds/{name}", uri] for name, uri in uris.items()]
    facts += [["publisher", f"/{name}", f"/rounds/{name}"] for name in uris]
    facts += [["type", f"/{name}", "std_msgs/String"] for name in uris]
    async with lying(mesh, facts=facts), asyncio.timeout(30):
        while "/remote/hospital/far" not in await names(mesh):  # noqa: ASYNC110 - asking
            await asyncio.sleep(0.1)
        assert [name for name in await names(mesh) if name.startswith("/remote")] == ["/remote/hospital/far"]
        await mesh["hall"].crew.hears("/viewer", POSE)


@pytest.mark.attack("flooding-site")
async def test_a_site_that_floods_is_dropped_and_disturbs_nobody(mesh: Mesh) -> None:
    async with lying(mesh, flood=100_000):
        await said(mesh, "site hospital has more than 65536 facts")
        await mesh["hall"].crew.hears("/viewer", POSE)
        state: Any = await mesh["hall"].see()
        assert state[0] == [[POSE, ["/robot"]]]
        assert "site hospital is not followed" in mesh["hall"].audit()


@pytest.mark.attack("rolled-back-site")
async def test_a_site_that_plays_back_an_older_list_revives_nobody(mesh: Mesh) -> None:
    """The master has seen the list in which a robot is revoked."""
    hospital, hall = mesh.domains["hospital"].site, mesh["hall"]
    old = mesh.root / "older"
    old.write_bytes(hospital.authority.store.newest_list() or b"")
    hospital.revoke(hospital.identity("/rounds/robot3").thumbprint)
    async with lying(mesh, facts=[["node", "/rounds/x", "http://10.98.0.9:4242/"]]):
        await until(lambda: saved(mesh) == hospital.authority.store.newest_list())
    async with lying(mesh, list=str(old)):
        await said(mesh, "older")
    assert saved(mesh) == hospital.authority.store.newest_list()
    await hall.crew.hears("/viewer", POSE)


def saved(mesh: Mesh) -> bytes | None:
    home, hospital = mesh.domains["home"].site, mesh.domains["hospital"].site
    files = DomainFiles(NodeHome.of(home.root, "/master"), home.anchor)
    return files.load_foreign(hospital.anchor.domain)


@pytest.mark.attack("site-impostor")
async def test_a_robot_at_the_masters_address_is_not_followed(mesh: Mesh) -> None:
    """It is admitted, and no master."""
    facts = [["node", "/rounds/x", "http://10.98.0.9:4242/"]]
    mesh.domains["hospital"].enroll("/rounds/robot5")
    async with lying(mesh, "/rounds/robot5", facts=facts):
        await said(mesh, "hospital:/rounds/robot5 answers at")
        assert await names(mesh) == [POSE]

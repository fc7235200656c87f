"""The masters of a relay's site: its own, and those it names."""

from collections.abc import AsyncIterator
from pathlib import Path

import pytest

from ca.errors import HintedError
from rossec.master.state.forwarded_ports import PeerWay, Target
from rossec.overlay.forwarded_ports import ForwardedPortTable, OpenPorts
from rossec.overlay.masters import OwnMasters, RelayMember
from tests.support.masters import Master, masters
from tests.support.site import Site
from tests.support.witness import until

KITCHEN = "/master/kitchen"
WAYS = {"office": PeerWay("idle", 0, 0, "", 0)}


async def carry(_: Target, sock: object) -> None:
    raise AssertionError("no forwarded port is used here")


class Mesh:
    """A hall whose master names the kitchen's, and the relay's links to both."""

    def __init__(self, hall: Master, kitchen: Master, found: OwnMasters, member: RelayMember):
        self.hall, self.kitchen, self.masters, self.member = hall, kitchen, found, member

    def name(self, *named: Master) -> None:
        """What the hall's master says from now on."""
        uris = {each.name: each.server.uri for each in named}
        self.hall.server.state.forwarded_ports.masters = lambda: uris
        self.hall.server.state.relay_polls.notify()


@pytest.fixture
async def mesh(tmp_path: Path) -> AsyncIterator[Mesh]:
    site = Site(tmp_path)
    site.enroll("/relay")
    async with masters(site, "/master", KITCHEN) as (hall, kitchen):
        member = RelayMember(
            "/relay", {"ROSSEC_HOME": str(tmp_path), "ROS_MASTER_URI": hall.server.uri, "ROS_IP": "127.0.0.1"}
        )
        member.start()
        await until(lambda: member.is_connected)
        table = ForwardedPortTable(OpenPorts("127.0.0.1"), carry, lambda: WAYS)
        found = OwnMasters(member, "instance", table)
        made = Mesh(hall, kitchen, found, member)
        made.name(hall, kitchen)
        found.start()
        try:
            yield made
        finally:
            await found.close()
            await table.close()
            await member.close()


async def test_every_master_that_is_named_is_polled(mesh: Mesh) -> None:
    await until(lambda: mesh.masters.status() == {"/master": "", KITCHEN: ""})
    target = Target("office", "node", "/robot")
    for each in (mesh.hall, mesh.kitchen):
        each.server.state.forwarded_ports.want("office", [target])
    await until(lambda: mesh.kitchen.server.state.forwarded_ports.forwarded_port(target))
    await until(lambda: mesh.hall.server.state.forwarded_ports.forwarded_port(target))
    assert mesh.hall.server.state.forwarded_ports.forwarded_port(
        target
    ) == mesh.kitchen.server.state.forwarded_ports.forwarded_port(target)
    mesh.name(mesh.hall)
    await until(lambda: mesh.masters.status() == {"/master": ""})
    mesh.name(mesh.hall, mesh.kitchen)
    await until(lambda: KITCHEN in mesh.masters.status())


async def test_a_target_is_where_its_master_says(mesh: Mesh) -> None:
    await until(lambda: KITCHEN in mesh.masters.status())
    await mesh.kitchen.register("/robot", "/robot/pose", 4711)
    ask = mesh.masters.target
    assert await ask("", "node", "/robot") == ("127.0.0.1", 4711)
    for name, master in (("/master", mesh.hall), (KITCHEN, mesh.kitchen)):
        _, port = await ask("", "master", name)
        assert port == master.server.port
    for kind, name in (("node", "/nobody"), ("master", "/master/attic"), ("service", "/x")):
        with pytest.raises(HintedError, match=f"no {kind} {name} is shown there"):
            await ask("", kind, name)
    with pytest.raises(HintedError, match="no domain is called"):
        await ask("office", "node", "/robot")


async def test_a_master_that_is_away_hides_only_what_is_registered_there(mesh: Mesh) -> None:
    await until(lambda: KITCHEN in mesh.masters.status())
    await mesh.hall.register("/robot", "/robot/pose", 4711)
    await mesh.kitchen.stop()
    assert await mesh.masters.target("", "node", "/robot") == ("127.0.0.1", 4711)
    with pytest.raises(HintedError):
        await mesh.masters.target("", "node", "/nobody")
    await until(lambda: mesh.masters.status()[KITCHEN] != "")


async def test_a_revoked_master_is_not_asked(mesh: Mesh) -> None:
    await until(lambda: mesh.masters.status() == {"/master": "", KITCHEN: ""})
    site = mesh.hall.site
    mesh.hall.take_list(site.revoke(site.identity(KITCHEN).thumbprint))
    await until(lambda: mesh.member.trust_status.own.entries)
    mesh.name(mesh.hall)
    await until(lambda: KITCHEN not in mesh.masters.status())
    mesh.name(mesh.hall, mesh.kitchen)
    await until(lambda: mesh.masters.status().get(KITCHEN))
    with pytest.raises(HintedError):
        await mesh.masters.target("", "master", KITCHEN)


async def test_lists_are_asked_for_as_soon_as_the_master_has_them(
    mesh: Mesh, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("rossec.master.server.answers.WATCH_WAIT", 600.0)
    monkeypatch.setattr("rossec.participant.membership.HEARTBEAT", 600.0)
    await until(lambda: mesh.masters.status().get("/master") == "")
    mesh.hall.take_list(mesh.hall.site.revoke(bytes(32)))
    await until(lambda: bytes(32) in mesh.member.trust_status.own.entries, within=8)

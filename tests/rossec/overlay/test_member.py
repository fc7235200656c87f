"""The relay as a node of its domain, at a real master."""

import asyncio
import contextlib
from collections.abc import AsyncIterator
from functools import partial
from pathlib import Path

import pytest

from ca.certificates import Identity
from ca.domains import Anchors
from ca.errors import CAError, NotAdmitted, RevocationsStale, Revoked
from rossec.errors import ChannelClosed, ConfigurationError
from rossec.net.aio import SecureContext, SecureStream, WireProtocol, connect, serve
from rossec.overlay.masters import RelayMember
from tests.support.relayedsites import RelayedSite, Wires, tell
from tests.support.witness import until


class World:
    """A home whose relay is a member, and an office whose relay makes links to it."""

    def __init__(self, root: Path) -> None:
        wires = Wires()
        self.home, self.office = (RelayedSite(root / each, each, wires) for each in ("home", "office"))
        self.member: RelayMember
        self.links: list[SecureStream[Identity]] = []
        self.errors: list[BaseException] = []

    async def start(self) -> None:
        for one, other in ((self.home, self.office), (self.office, self.home)):
            one.trust(other)
            await one.master.start()
        self.member = RelayMember(
            "/relay",
            {
                "ROSSEC_HOME": str(self.home.site.root),
                "ROS_IP": "127.0.0.1",
                "ROS_MASTER_URI": self.home.master.server.uri,
            },
        )

    async def admit(self, stream: SecureStream[Identity]) -> None:
        try:
            self.member.admit(stream)
        except CAError as error:
            self.errors.append(error)
            raise ChannelClosed("refused") from error
        self.links.append(stream)
        await stream.wait_ended()

    def has_errors(self, count: int) -> bool:
        return len(self.errors) == count

    @contextlib.asynccontextmanager
    async def link(self, of: str = "office") -> AsyncIterator[SecureStream[Identity]]:
        """A link to the member, from the relay of one of the sites."""
        site = self.office if of == "office" else self.home
        home = site.site.enroll("/relay" if of == "office" else "/relay/attic")
        anchors = self.member.trust_status.anchors
        if of == "office":
            anchors = Anchors(site.site.anchor)
            anchors.update(site.master.domains)
        context = SecureContext(home.credentials(), anchors.verify)
        async with serve(self.admit, "127.0.0.1", 0, self.member.link_context, WireProtocol.HTTP) as server:
            stream = await connect("127.0.0.1", server.port, context, WireProtocol.HTTP)
            yield stream
            stream.abort("done")


@pytest.fixture
async def world(tmp_path: Path) -> AsyncIterator[World]:
    made = World(tmp_path)
    await made.start()
    made.member.start()
    await until(lambda: made.member.is_connected)
    try:
        yield made
    finally:
        await made.member.close()
        for each in (made.home, made.office):
            await each.master.stop()


async def test_it_has_the_lists_of_its_master(world: World) -> None:
    member = world.member
    assert member.master == "/master"
    assert member.identity.name == "/relay"
    assert member.trust_status.anchors.data == world.home.master.domains
    world.home.master.take_domains(world.home.trust())
    await member.refresh()
    assert member.trust_status.anchors.all_listed == ()
    await world.home.master.stop()
    await member.refresh()  # is tried again later
    await world.home.master.start()


async def test_a_link_with_a_relay_of_another_domain_is_cut_when_its_domain_goes(world: World) -> None:
    tell(world.home, world.office)
    await world.member.refresh()
    async with world.link():
        await until(lambda: world.links)
        (link,) = world.links
        world.member.check_target(link.peer, "node")
        world.home.master.take_domains(world.home.trust())
        await world.member.refresh()
        assert link.error is not None
        with pytest.raises(NotAdmitted):
            world.member.check_target(link.peer, "master")


async def test_what_is_stale_leads_to_masters_only(world: World) -> None:
    async with world.link():
        await until(lambda: world.links)
        (link,) = world.links
        world.member.check_target(link.peer, "master")
        for kind in ("node", "service"):
            with pytest.raises(RevocationsStale):
                world.member.check_target(link.peer, kind)
        tell(world.home, world.office)
        await world.member.refresh()
        world.member.check_target(link.peer, "node")


async def test_a_relay_that_is_revoked_here_is_refused_and_cut(world: World) -> None:
    async with world.link():
        await until(lambda: world.links)
        world.home.master.take_list(world.home.site.revoke(world.office.site.identity("/relay").thumbprint))
        await world.member.refresh()
        assert world.links[0].error is not None
    async with world.link():
        await until(lambda: world.errors)
        assert isinstance(world.errors[0], Revoked)


async def test_a_relay_of_the_own_domain_comes_only_while_the_own_list_is_fresh(world: World) -> None:
    async with world.link("home"):
        await until(lambda: world.links)
        world.member.check_target(world.links[0].peer, "node")
        world.member.access.expire_confirmation(1)
        with pytest.raises(RevocationsStale):
            world.member.check_target(world.links[0].peer, "master")
    for count, of in enumerate(("home", "office"), 1):
        async with world.link(of):
            await until(partial(world.has_errors, count))
    assert all(isinstance(each, RevocationsStale) for each in world.errors)


async def test_a_crash_cuts_every_link_and_admits_none(world: World) -> None:
    async with world.link("home"):
        await until(lambda: world.links)
        world.member.crashed(RuntimeError("a bug"))
        assert world.links[0].error is not None
        with pytest.raises(RuntimeError, match="a bug"):
            async with asyncio.timeout(5):
                await world.member.wait_ended()
    async with world.link("home") as stream:
        await stream.wait_ended()
    assert len(world.links) == 1


async def test_links_end_with_the_relay(world: World) -> None:
    async with world.link("home"):
        await until(lambda: world.links)
        await world.member.close()
        assert world.links[0].error is not None


async def test_a_relay_that_is_not_enrolled(tmp_path: Path) -> None:
    with pytest.raises(ConfigurationError, match="/relay has no"):
        RelayMember("/relay", {"ROSSEC_HOME": str(tmp_path)})

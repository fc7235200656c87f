"""Who has the descriptor of a relay, or forges one, is still not that relay."""

import asyncio
import contextlib
from collections.abc import AsyncIterator
from dataclasses import replace
from functools import partial
from pathlib import Path

import pytest

from ca.certificates import Identity
from ca.domains import Anchors
from rossec.errors import ChannelError
from rossec.net.aio import SecureContext, SecureStream, WireProtocol, connect, serve
from rossec.overlay.documents import Peer
from tests.support.relayedsites import RelayedSite, two_sites
from tests.support.witness import until

pytestmark = pytest.mark.attack("relay-impostor")
Sites = tuple[RelayedSite, RelayedSite]


@pytest.fixture
async def sites(tmp_path: Path) -> AsyncIterator[Sites]:
    async with two_sites(tmp_path) as both:
        yield both


@pytest.fixture
async def eve(sites: Sites, tmp_path: Path) -> RelayedSite:
    """A third site, which both others trust as well."""
    found = RelayedSite(tmp_path / "eve", "eve.example", sites[0].wires)
    found.trust(*sites)
    for one, other in (sites, sites[::-1]):
        one.master.take_domains(one.trust(other, found))
        await until(partial(one.member.trust_status.anchors.listed, "eve"))
    return found


def context_of(site: RelayedSite, name: str) -> SecureContext[Identity]:
    anchors = Anchors(site.site.anchor)
    anchors.update(site.master.domains)
    return SecureContext(site.site.enroll(name).credentials(), anchors.verify)


async def is_let_in(home: RelayedSite, office: RelayedSite, own: SecureContext[Identity]) -> bool:
    """Whether somebody gets further than the handshake at the inbox that home told the office."""
    port = home.wires.ports[home.relay_inbox(office)]
    with contextlib.suppress(ChannelError):
        stream = await connect("127.0.0.1", port, own, WireProtocol.HTTP)
        with contextlib.suppress(ChannelError, TimeoutError):
            async with asyncio.timeout(1):
                await stream.wait_ended()
        if stream.error is None:
            stream.abort("let in")
            return True
    return False


async def test_a_stolen_descriptor_lets_in_nobody_else(sites: Sites, eve: RelayedSite) -> None:
    home, office = sites
    thieves = {
        "a node of that site": context_of(office, "/robot"),
        "its master": context_of(office, "/master"),
        "another relay of it": context_of(office, "/relay/attic"),
        "the relay of a third site": context_of(eve, "/relay"),
        "a node of this site": context_of(home, "/robot"),
        "this relay itself": context_of(home, "/relay"),
    }
    let_in = [who for who, own in thieves.items() if await is_let_in(home, office, own)]
    assert let_in == []
    assert await is_let_in(home, office, context_of(office, "/relay"))  # the control


async def test_a_site_that_is_not_trusted_has_no_use_of_a_descriptor(sites: Sites, tmp_path: Path) -> None:
    home, office = sites
    stranger = RelayedSite(tmp_path / "stranger", "stranger.example", home.wires)
    stranger.trust(home)
    assert not await is_let_in(home, office, context_of(stranger, "/relay"))


async def test_what_comes_in_at_a_forwarded_port_is_not_carried_to_who_forged_the_descriptor(
    sites: Sites, eve: RelayedSite
) -> None:
    """Home is given a descriptor of the office with an inbox that Eve reads."""
    home, _ = sites
    heard: list[bytes] = []

    async def listen(stream: SecureStream[Identity]) -> None:
        heard.append(await stream.receive())

    trap = serve(listen, "127.0.0.1", 0, context_of(eve, "/relay"), WireProtocol.HTTP)
    key = f"rossec/1/eve/{'e' * 32}"
    home.wires.ports[key] = trap.port

    def forge(peers: dict[str, Peer]) -> None:
        peers["office"] = replace(peers["office"], inbox=key)

    home.files.change(forge)
    await asyncio.sleep(1.5)  # the file is read within a second
    forwarded_port = await home.forwarded_port("office", "master", "/master")
    for _ in range(3):
        with pytest.raises((ChannelError, OSError)):
            await home.through(forwarded_port)
        await asyncio.sleep(0.6)
    await trap.close()
    assert heard == []
    assert key in home.network.dialled
    (peer,) = home.relay.status()["peers"]
    assert "eve:/relay is at the inbox of office, not office:/relay" in peer["error"]

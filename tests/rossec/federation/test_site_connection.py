"""Who answers where a site is dialled."""

from collections.abc import AsyncIterator
from dataclasses import replace
from pathlib import Path

import pytest

from rossec.errors import IdentityRefused, RelayRefused, RossecError, SiteRefused
from rossec.federation import follower
from rossec.federation.exchange import OwnMaster
from rossec.federation.follower import SiteConnections, SitePorts
from rossec.federation.settings import SiteSettings
from rossec.master.state.forwarded_ports import ForwardedPort, PeerWay, RelayReport, Target
from tests.support.masters import Master, masters
from tests.support.relaying import StraightRelay, relayed
from tests.support.site import Site


class Dialled:
    """`/master` that dials `/master/kitchen`."""

    def __init__(self, hall: Master, kitchen: Master) -> None:
        self.hall, self.kitchen = hall, kitchen
        server = hall.server
        self.own = OwnMaster(server.state, server.effects, server.context, server.mirror, server.drop_mirror)

    def connections(self, settings: SiteSettings) -> SiteConnections:
        forwarded_ports = None
        if settings.via:
            forwarded_ports = SitePorts(self.own.state.forwarded_ports, settings, lambda: None)
        return SiteConnections(settings, self.own, forwarded_ports)


@pytest.fixture
async def dialled(tmp_path: Path) -> AsyncIterator[Dialled]:
    async with masters(Site(tmp_path / "site"), "/master", "/master/kitchen") as found:
        yield Dialled(*found)


async def test_the_master_of_a_site_is_reached(dialled: Dialled) -> None:
    connections = dialled.connections(dialled.kitchen.as_site("kitchen"))
    async with connections.open() as (client, peer):
        assert peer.name == "/master/kitchen"
        assert await client.ask("getUri", "/master") == dialled.kitchen.server.uri
    assert client.closed or await _ends(client)


async def _ends(client: object) -> bool:
    with pytest.raises(RossecError):
        await client.ask("getUri", "/master")  # type: ignore[attr-defined]
    return True


async def test_another_one_is_refused(dialled: Dialled) -> None:
    settings = replace(dialled.kitchen.as_site("cellar"), master="/master/cellar")
    with pytest.raises(SiteRefused, match=r"kitchen answers at http:.*, not /master/cel"):
        async with dialled.connections(settings).open():
            pass
    ward = replace(settings, domain="ward")
    with pytest.raises(SiteRefused, match="not /master/cellar of ward"):
        async with dialled.connections(ward).open():
            pass


async def test_a_revoked_one_is_refused(dialled: Dialled) -> None:
    connections = dialled.connections(dialled.kitchen.as_site("kitchen"))
    async with connections.open() as (_, peer):
        connections.check_trust(peer)
        dialled.hall.take_list(dialled.hall.site.revoke(peer.thumbprint))
        with pytest.raises(SiteRefused, match="/master/kitchen: "):
            connections.check_trust(peer)
    with pytest.raises((SiteRefused, IdentityRefused)):
        async with connections.open():
            pass


async def test_a_site_is_reached_at_its_forwarded_port(
    dialled: Dialled, monkeypatch: pytest.MonkeyPatch
) -> None:
    here, there = StraightRelay(dialled.hall), StraightRelay(dialled.kitchen, "/relay/kitchen")
    here.meet("kitchen", there)
    settings = SiteSettings("kitchen", "", "/master/kitchen", via="kitchen")
    async with relayed(here, there), dialled.connections(settings).open() as (_, peer):
        assert peer.name == "/master/kitchen"
        wrong = replace(settings, label="cellar", via="kitchen", master="/master/cellar")
        with pytest.raises(RossecError):  # there is no such master
            async with dialled.connections(wrong).open():
                pass
    monkeypatch.setattr(follower, "FORWARDED_PORT_WAIT", 0.05)
    dialled.own.state.forwarded_ports.expire(dialled.own.state.now() + 100)
    with pytest.raises(RelayRefused, match="no relay of this site knows"):
        async with dialled.connections(settings).open():
            pass


async def test_who_answers_at_a_forwarded_port_is_checked(dialled: Dialled) -> None:
    settings = SiteSettings("office", "", "/master/office", via="office")
    target = Target("office", "master", "/master/office")
    connections, forwarded_ports = dialled.connections(settings), dialled.own.state.forwarded_ports
    forwarded_ports.want("office", [target])
    ways = {"office": PeerWay("up", 0.0, 0, "", 0)}
    forwarded_port = {target: ForwardedPort("127.0.0.1", dialled.kitchen.server.port)}
    forwarded_ports.hear("/relay", RelayReport("one", 0, forwarded_port, ways), dialled.own.state.now())
    with pytest.raises(SiteRefused, match="/master/kitchen answers via office, not /master/office"):
        async with connections.open():
            pass

"""Sites that are reached by a relay, with real masters and a relay that needs no overlay."""

import asyncio
import time
from collections.abc import AsyncIterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from ca.domains import ForeignDomain
from rossec.errors import RelayRefused
from rossec.federation import follower
from rossec.federation.follower import SitePorts
from rossec.federation.settings import SiteSettings
from rossec.federation.site_state import SiteChange
from rossec.master.state.forwarded_ports import (
    MASTER,
    NODE,
    ForwardedPort,
    ForwardedPorts,
    PeerWay,
    RelayReport,
    Target,
)
from rossec.ros.names import is_forwarded_port
from tests.support.masters import Master, domain_list, masters
from tests.support.relaying import StraightRelay, relayed
from tests.support.site import DAY, Site
from tests.support.witness import until

OFFICE = SiteSettings("office", "", "/master/office", via="office")
AT = ForwardedPort("127.0.0.1", 7001)
MASTER_THERE = Target("office", MASTER, "/master/office")
ROBOT = Target("office", NODE, "/robot")
WAY = PeerWay("up", 1.5, 2, "tls/r:7447", 3)
FACTS = frozenset({("node", "/robot", "http://10.0.0.2:4711/"), ("publisher", "/pose", "/robot")})


class Pair:
    """Two masters of one domain whose relays know each other as `office` and `hall`."""

    def __init__(self, hall: Master, office: Master) -> None:
        self.hall, self.office = hall, office
        self.here, self.there = StraightRelay(hall), StraightRelay(office, "/relay/office")
        self.here.meet("office", self.there)
        self.there.meet("hall", self.here)

    @property
    def state(self) -> dict[str, Any]:
        return self.hall.state_of("office")


@pytest.fixture
async def pair(tmp_path: Path) -> AsyncIterator[Pair]:
    async with masters(Site(tmp_path / "site"), "/master", "/master/office") as found:
        found[0].want()
        yield Pair(*found)


async def test_facts_behind_a_relay_have_forwarded_ports_for_addresses(pair: Pair) -> None:
    await pair.office.register("/robot", "/pose", 4711)
    pair.hall.follow(OFFICE)
    async with relayed(pair.here, pair.there):
        await until(lambda: pair.hall.imported("/pose"))
        [uri] = pair.hall.imported("/pose")
        forwarded_port = pair.hall.server.state.forwarded_ports.forwarded_port(ROBOT)
        assert forwarded_port is not None
        assert is_forwarded_port(uri)
        assert uri == f"http://127.0.0.1:{forwarded_port.port}/via"
        await until(lambda: pair.state["state"] == "following")
        assert (pair.state["via"], pair.state["uri"]) == ("office", "")
        assert pair.state["topics"] == ["/pose"]
        assert pair.state["way"]["relay"] == "/relay"
        assert pair.state["way"]["rtt_ms"] == 1.5
        pair.office.unregister("/robot")
        await until(lambda: ROBOT not in pair.here.servers)
        assert pair.hall.imported("/pose") == []


async def test_a_relay_that_is_started_again_opens_other_forwarded_ports(pair: Pair) -> None:
    await pair.office.register("/robot", "/pose", 4711)
    pair.hall.follow(OFFICE)
    async with relayed(pair.there):
        async with relayed(pair.here):
            await until(lambda: pair.hall.imported("/pose"))
            before = pair.hall.imported("/pose")
        await until(lambda: pair.state["state"] != "following")
        assert pair.hall.imported("/pose") == before, "facts stay for a minute"
        again = StraightRelay(pair.hall, instance="two")
        again.meet("office", pair.there)
        async with relayed(again):
            await until(lambda: pair.state["state"] == "following")
            await until(lambda: pair.hall.imported("/pose") != before)
            assert len(pair.hall.imported("/pose")) == 1


async def test_without_a_relay_it_is_said_what_is_missing(
    pair: Pair, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(follower, "FORWARDED_PORT_WAIT", 0.2)
    pair.hall.follow(OFFICE)
    await until(lambda: pair.state["error"])
    assert pair.state["error"] == "no relay of this site knows a peer office"
    assert "rossec relay add office FILE" in pair.state["hint"]
    assert pair.state["way"] == {}
    async with relayed(pair.here, pair.there):  # it is dialled as soon as there is a forwarded port
        await until(lambda: pair.state["state"] == "following", within=10)
        assert pair.state["error"] == ""


async def test_a_forwarded_port_that_leads_nowhere_is_the_relays_matter(pair: Pair) -> None:
    await pair.office.stop()
    pair.hall.follow(OFFICE)
    async with relayed(pair.here, pair.there):
        await until(lambda: pair.state["error"], within=10)
        assert pair.state["hint"] == "is there a link? rossec relay status"


async def test_another_master_behind_the_forwarded_port_is_refused(pair: Pair) -> None:
    pair.hall.follow(replace(OFFICE, master="/master/cellar"))
    pair.office.name = "/master/cellar"
    pair.there.link = pair.here.link  # asks the wrong master
    async with relayed(pair.here):
        await until(lambda: pair.state["error"])
    assert pair.state["state"] in ("lost", "dialling", "idle")
    assert pair.hall.imported("/pose") == []


async def test_a_master_that_is_removed_wants_no_forwarded_ports(pair: Pair) -> None:
    await pair.office.register("/robot", "/pose", 4711)
    mesh = pair.hall.follow(OFFICE)
    async with relayed(pair.here, pair.there):
        await until(lambda: pair.hall.imported("/pose"))
        mesh._sources = {}
        mesh._last = {}
        await until(lambda: not pair.here.servers)
        assert pair.hall.imported("/pose") == []


async def test_masters_in_the_mesh_are_told_to_the_relay(pair: Pair) -> None:
    pair.hall.follow(pair.office.as_site("office"))
    forwarded_ports = pair.hall.server.state.forwarded_ports
    await until(lambda: forwarded_ports.masters() == {"/master/office": pair.office.server.uri})


async def test_a_foreign_site_is_reached_and_its_rules_hold(tmp_path: Path) -> None:
    home, ward = Site(tmp_path / "home"), Site(tmp_path / "ward", "ward.example")
    hall, nurse = Master(home), Master(ward)
    until_then = int(time.time()) + DAY
    known = ForeignDomain(
        "ward.example", "ward", ward.anchor.certificate, ("/**", "/master"), 3600, until_then
    )
    back = ForeignDomain(
        home.anchor.domain, "home", home.anchor.certificate, ("/**", "/master"), 3600, until_then
    )
    for master, entry in ((hall, known), (nurse, back)):
        master.domains = domain_list(master.site, "/master", foreign=[entry])
        await master.start()
    here, there = StraightRelay(hall), StraightRelay(nurse)
    here.meet("ward", there, "home")
    there.meet("home", here, "ward")
    hall.follow(SiteSettings("ward", "", domain="ward", via="ward"))
    try:
        async with relayed(here, there):
            await until(lambda: hall.state_of("ward")["state"] == "listening")
            assert there.sources
            assert not hall.state_of("ward")["facts"]
    finally:
        await hall.stop()
        await nurse.stop()


class Doorless:
    """The forwarded ports of a site, with a relay that polls when it is told to."""

    def __init__(self, limit: int = 100) -> None:
        self.forwarded_ports = ForwardedPorts(limit)
        self.woken = 0
        self.site = SitePorts(self.forwarded_ports, OFFICE, self._wake)

    def _wake(self) -> None:
        self.woken += 1

    def report(self, instance: str = "one", **ports: int) -> None:
        known = {"master": MASTER_THERE, "robot": ROBOT}
        forwarded_ports = {known[name]: ForwardedPort("127.0.0.1", port) for name, port in ports.items()}
        self.forwarded_ports.hear("/relay", RelayReport(instance, 0, forwarded_ports, {"office": WAY}), 0)


async def test_the_masters_forwarded_port_is_waited_for() -> None:
    doorless = Doorless()
    waiting = asyncio.ensure_future(doorless.site.address())
    await asyncio.sleep(0)
    doorless.report(master=7001)
    assert await waiting == ("127.0.0.1", 7001)
    assert doorless.woken == 1
    doorless.report(master=7001)
    assert doorless.woken == 1
    doorless.report("two")
    doorless.report("two", master=7002)
    assert doorless.woken == 2
    assert doorless.site.status()["router"] == "tls/r:7447"


async def test_a_relay_that_opens_no_forwarded_port_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(follower, "FORWARDED_PORT_WAIT", 0.01)
    doorless = Doorless()
    doorless.report()
    with pytest.raises(RelayRefused, match="opens no forwarded port for /master/office of office"):
        await doorless.site.address()


async def test_facts_are_shown_without_forwarded_ports_that_do_not_come(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(follower, "NODES_WAIT", 0.01)
    doorless = Doorless()
    doorless.report()
    shown = await doorless.site.take(SiteChange(FACTS, frozenset(), True, b"", b""))
    assert shown.added == {("publisher", "/pose", "/robot")}
    doorless.report(robot=7003)
    assert doorless.site.changed.is_set()
    again = doorless.site.refreshed()
    assert again.added == {("node", "/robot", "http://127.0.0.1:7003/via")}
    assert not doorless.site.changed.is_set()


async def test_more_than_there_are_forwarded_ports_is_said_once(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(follower, "NODES_WAIT", 0.01)
    doorless = Doorless(limit=1)
    for _ in range(2):
        await doorless.site.take(SiteChange(FACTS, frozenset(), True, b"", b""))
    assert caplog.text.count("1 nodes and services have no address here") == 1
    doorless.site.drop()
    doorless.site.close()
    assert doorless.forwarded_ports.want("other", [ROBOT]) == 0

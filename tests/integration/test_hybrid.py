"""Meshed inside a site, routed between sites, in one configuration: thesis 3.5.1.

One domain in two places. Hall and kitchen follow each other straight, the office is behind the
relay, which serves both. Masters, relays and nodes are real; what is between the two relays is TCP.
"""

import asyncio
import contextlib
import hashlib
from collections.abc import AsyncIterator
from functools import partial
from pathlib import Path
from typing import Any, cast

import pytest

from grants.model import Right
from rossec.federation.settings import read_config
from rossec.master.operation.config import parse
from rossec.overlay.documents import Peer
from rossec.overlay.forwarded_ports import OpenPorts
from rossec.overlay.homes import RelayFiles
from rossec.overlay.link_frames import inbox
from rossec.overlay.masters import RelayMember
from rossec.overlay.relay import Relay
from rossec.ros.names import is_forwarded_port
from tests.support.masters import Master, masters
from tests.support.relayedsites import WireNetwork, Wires
from tests.support.site import Site
from tests.support.witness import until

HALL, KITCHEN, OFFICE = "/master", "/master/kitchen", "/master/office"
BOX = {name: hashlib.sha256(name.encode()).hexdigest()[:32] for name in ("hall", "office")}


class Place:
    """A relay at the master of its place, and the one peer that it knows."""

    def __init__(self, master: Master, relay: str, label: str, wires: Wires) -> None:
        self.master, self.name, self.label = master, relay, label
        self.files = RelayFiles(master.site.enroll(relay))
        environ = {
            "ROSSEC_HOME": str(master.site.root),
            "ROS_MASTER_URI": master.server.uri,
            "ROSSEC_MASTER": master.name,
            "ROS_IP": "127.0.0.1",
        }
        self.member = RelayMember(relay, environ)
        network = WireNetwork(wires, label, self.member.link_context)
        self.relay = Relay(self.member, cast("Any", network), OpenPorts("127.0.0.1"), self.files.peers)

    @property
    def inbox(self) -> str:
        return inbox(self.label, bytes.fromhex(BOX[self.label]))

    def add(self, other: "Place") -> None:
        peer = Peer(other.label, BOX[self.label], "", other.name, other.inbox)
        self.files.change(lambda peers: peers.update({other.label: peer}))


class Home:
    """The three masters and two relays."""

    def __init__(self, site: Site, found: list[Master]) -> None:
        self.site = site
        self.hall, self.kitchen, self.office = found
        wires = Wires()
        self.here = Place(self.hall, "/relay", "hall", wires)
        self.there = Place(self.office, "/relay/office", "office", wires)
        self.here.add(self.there)
        self.there.add(self.here)

    def follow(self) -> None:
        """As the configuration file of each master says."""
        hall, kitchen = self.hall.server.uri, self.kitchen.server.uri
        office = "    office: {via: office, master: /master/office}\n"
        inside = "    hall: {via: hall}\n    kitchen: {via: hall, master: /master/kitchen}\n"
        for master, sites in (
            (self.hall, f"    kitchen: {{uri: '{kitchen}', master: /master/kitchen}}\n{office}"),
            (self.kitchen, f"    hall: {{uri: '{hall}'}}\n{office}"),
            (self.office, inside),
        ):
            text = f"federation:\n  sites:\n{sites}"
            master.follow(*read_config(parse(text, "m.yaml").federation, "m.yaml").sites)


@pytest.fixture
async def home(tmp_path: Path) -> AsyncIterator[Home]:
    site = Site(tmp_path / "site")
    async with masters(site, HALL, KITCHEN, OFFICE) as found:
        home = Home(site, found)
        home.follow()
        running = [asyncio.ensure_future(each.relay.run()) for each in (home.here, home.there)]
        try:
            yield home
        finally:
            for task in running:
                task.cancel()
            await asyncio.gather(*running, return_exceptions=True)


def imports(master: Master, topics: tuple[str, ...]) -> bool:
    return all(map(master.imported, topics))


def ways(master: Master) -> dict[str, str]:
    """State and way of each site of a master."""
    rows: list[dict[str, Any]] = master.mesh.status()["sites"]
    return {
        row["label"]: f"{row['state']} {row['way'].get('relay', '-') if row['via'] else 'straight'}"
        for row in rows
    }


async def test_a_mesh_inside_and_relays_between(home: Home) -> None:
    for master in (home.hall, home.kitchen, home.office):
        master.want()
    await home.hall.register("/lamp", "/light", 4711)
    await home.kitchen.register("/oven", "/heat", 4712)
    await home.office.register("/desk", "/paper", 4713)
    for master, topics in (
        (home.hall, ("/heat", "/paper")),
        (home.kitchen, ("/light", "/paper")),
        (home.office, ("/light", "/heat")),
    ):
        await until(partial(imports, master, topics))
    straight, routed, behind = "following straight", "following /relay", "following /relay/office"
    await until(lambda: ways(home.hall) == {"kitchen": straight, "office": routed})
    await until(lambda: ways(home.kitchen) == {"hall": straight, "office": routed})
    await until(lambda: ways(home.office) == {"hall": behind, "kitchen": behind})

    assert home.hall.imported("/heat") == ["http://127.0.0.1:4712/"]
    assert home.kitchen.imported("/light") == ["http://127.0.0.1:4711/"]
    assert home.hall.imported("/paper") == home.kitchen.imported("/paper"), "one forwarded port serves both"
    for topic in ("/light", "/heat"):
        [uri] = home.office.imported(topic)
        assert is_forwarded_port(uri)
    [uri] = home.hall.imported("/paper")
    assert is_forwarded_port(uri)


async def test_a_topic_from_the_office_to_a_node_of_the_meshed_kitchen(home: Home) -> None:
    site = home.site
    for name in ("/desk", "/cook"):
        site.enroll(name)
    site.grant("/desk", Right.PUBLISH, "/paper")
    site.grant("/cook", Right.SUBSCRIBE, "/paper")
    async with contextlib.AsyncExitStack() as stack:
        clerk = await stack.enter_async_context(home.office.node("/desk"))
        cook = await stack.enter_async_context(home.kitchen.node("/cook"))
        paper = await clerk.publisher("/paper", "std_msgs/String", latch=True)
        paper.publish(paper.create(data="lunch at one"))
        wanted = await cook.subscriber("/paper", "std_msgs/String")
        async with asyncio.timeout(30):
            message = await anext(aiter(wanted))
        assert message.data == "lunch at one"
        row = home.kitchen.state_of("office")
        assert row["topics"] == ["/paper"]
        await until(lambda: home.kitchen.state_of("office")["way"].get("streams"))

"""A relay with real masters and nodes on both sides, and links over TCP instead of routers."""

import asyncio
from collections.abc import AsyncIterator
from pathlib import Path

import pytest

from ca.certificates import Identity
from grants.model import Right
from rossec.errors import ChannelError
from rossec.federation.settings import SiteSettings
from rossec.net.aio import SecureStream, WireProtocol
from rossec.net.rpc.calls import RpcClient
from tests.support.relayedsites import RelayedSite, tell, two_sites
from tests.support.trust import accept, share
from tests.support.witness import until

Sites = tuple[RelayedSite, RelayedSite]


@pytest.fixture
async def sites(tmp_path: Path) -> AsyncIterator[Sites]:
    async with two_sites(tmp_path) as both:
        yield both


def peer_of(site: RelayedSite) -> dict[str, object]:
    (found,) = site.relay.status()["peers"]
    assert isinstance(found, dict)
    return found


async def ended(stream: SecureStream[Identity]) -> None:
    async with asyncio.timeout(30):
        with pytest.raises(ChannelError):
            await stream.receive()


async def test_a_forwarded_port_leads_to_the_master_of_the_peer(sites: Sites) -> None:
    home, office = sites
    forwarded_port = await home.forwarded_port("office", "master", "/master")
    assert peer_of(home)["state"] == "idle"
    assert home.network.dialled == []  # nothing until a forwarded port is used
    stream = await home.through(forwarded_port)
    assert stream.peer.name == "/remote/office/master"
    client = RpcClient(stream)
    assert await client.ask("getUri", "/master") == office.master.server.uri
    assert peer_of(home) | {"state": "linked", "streams": 1, "error": ""} == peer_of(home)
    assert peer_of(office)["called"] == 1
    again = await home.through(forwarded_port)
    assert len(home.network.dialled) == 1  # one link carries both
    await until(lambda: peer_of(home)["streams"] == 2)
    await again.close()
    await client.close()
    await until(lambda: peer_of(home)["streams"] == 0)


async def test_who_comes_by_a_relay_is_not_near(sites: Sites) -> None:
    home, office = sites
    stream = await home.through(await home.forwarded_port("office", "master", "/master"))
    streams = office.master.server.state.streams
    await until(lambda: any(each.peer.is_foreign for each in streams))
    (seen,) = [each for each in streams if each.peer.is_foreign]
    assert seen.address.startswith("127.82.")
    await stream.close()


async def test_a_forwarded_port_leads_to_a_node_and_its_topics(sites: Sites) -> None:
    home, office = sites
    office.site.publish("/robot", "/robot/pose")
    async with office.master.node("/robot") as robot:
        await robot.publisher("/robot/pose", "std_msgs/String")
        forwarded_port = await home.forwarded_port("office", "node", "/robot")
        for protocol in (WireProtocol.HTTP, WireProtocol.TCPROS):
            stream = await home.through(forwarded_port, protocol=protocol)
            assert stream.peer.name == "/remote/office/robot"
            await stream.close()


async def test_only_what_the_master_shows_is_reached(sites: Sites) -> None:
    home, office = sites
    office.master.take_domains(office.trust(home, exported=()))
    office.site.publish("/robot", "/robot/pose")
    async with office.master.node("/robot") as robot:
        await robot.publisher("/robot/pose", "std_msgs/String")
        for kind, name in (
            ("node", "/robot"),
            ("node", "/nobody"),
            ("service", "/robot/stop"),
            ("master", "/master/attic"),
        ):
            with pytest.raises(ChannelError):
                await home.through(await home.forwarded_port("office", kind, name))


async def test_the_removal_of_a_peer_cuts_its_links_on_both_sides(sites: Sites) -> None:
    home, office = sites
    forwarded_port = await home.forwarded_port("office", "master", "/master")
    stream = await home.through(forwarded_port)
    home.remove(office)
    await ended(stream)
    assert home.relay.status()["peers"] == []
    await until(lambda: peer_of(office)["called"] == 0)
    with pytest.raises(ChannelError):
        await home.through(forwarded_port)
    home.add(office)  # again: a forwarded port is opened anew
    await until(lambda: home.relay.status()["peers"] != [])
    home.master.server.state.forwarded_ports.want("office master /master", [])
    stream = await home.through(await home.forwarded_port("office", "master", "/master"))
    await stream.close()


async def test_the_called_side_removes_a_peer(sites: Sites) -> None:
    home, office = sites
    forwarded_port = await home.forwarded_port("office", "master", "/master")
    stream = await home.through(forwarded_port)
    office.remove(home)
    await ended(stream)
    await until(lambda: peer_of(home)["state"] == "failed")


@pytest.mark.parametrize("called", [False, True])
async def test_the_end_of_the_trust_in_a_domain_cuts_at_once(sites: Sites, called: bool) -> None:
    here, there = sites[::-1] if called else sites
    stream = await sites[0].through(await sites[0].forwarded_port("office", "master", "/master"))
    here.master.take_domains(here.trust())
    await ended(stream)
    await until(lambda: peer_of(there)["streams"] == 0)


@pytest.mark.parametrize("own", [False, True])
async def test_the_revocation_of_a_relay_cuts_at_once(sites: Sites, own: bool) -> None:
    """By the authority of the relay, and by that of the other site."""
    home, office = sites
    stream = await home.through(await home.forwarded_port("office", "master", "/master"))
    key = home.site.identity("/relay").thumbprint
    if own:
        home.master.take_list(home.site.revoke(key))
        tell(office, home)
    else:
        office.master.take_list(office.site.revoke(key))
    await ended(stream)
    await until(lambda: peer_of(office)["called"] == 0)


async def test_another_relay_of_that_domain_has_no_use_of_the_inbox(
    sites: Sites, caplog: pytest.LogCaptureFixture
) -> None:
    home, office = sites
    office.files.change(
        lambda peers: peers.update(
            home=peers["home"].__class__(
                "home", peers["home"].box, "home", "/relay/attic", peers["home"].inbox
            )
        )
    )
    await asyncio.sleep(1.5)
    with pytest.raises(ChannelError):
        await home.through(await home.forwarded_port("office", "master", "/master"))
    assert "home:/relay is at the inbox of home, not home:/relay/attic" in caplog.text
    assert peer_of(office)["called"] == 0


async def test_a_link_is_not_made_to_whom_does_not_answer_it(sites: Sites) -> None:
    home, office = sites
    forwarded_port = await home.forwarded_port("office", "master", "/master")
    await office.stop()
    home.wires.ports.clear()
    for _ in range(3):
        with pytest.raises(ChannelError):
            await home.through(forwarded_port)
    assert len(home.network.dialled) < 3  # the second ones are told at once
    assert peer_of(home)["state"] == "failed"
    assert peer_of(home)["error"] == "nobody answers"
    await office.start()

    async def comes_back() -> None:
        while True:
            try:
                await (await home.through(forwarded_port)).close()
            except ChannelError:
                await asyncio.sleep(0.1)
            else:
                return

    async with asyncio.timeout(20):
        await comes_back()
    assert peer_of(home)["error"] == ""


async def test_a_domain_that_was_accepted_before_there_were_relays(sites: Sites) -> None:
    home, office = sites
    home.master.take_domains(home.trust(office, admitted=("/master", "/rounds/*")))
    forwarded_port = await home.forwarded_port("office", "master", "/master")
    await until(lambda: home.member.trust_status.anchors.data == home.master.domains)
    with pytest.raises(ChannelError):
        await home.through(forwarded_port)
    assert "office:/relay is not admitted" in str(peer_of(home)["error"])
    hint = str(peer_of(home)["hint"])
    assert hint.endswith("rossec domain limit office --admit '/rounds/*'"), "and nobody else"


async def test_a_relay_may_come_before_its_domain_has_said_anything(tmp_path: Path) -> None:
    """Only to the masters, who judge by themselves; else two sites could never begin."""
    async with two_sites(tmp_path, told=False) as (home, office):
        office.site.publish("/robot", "/robot/pose")
        async with office.master.node("/robot") as robot:
            await robot.publisher("/robot/pose", "std_msgs/String")
            stream = await home.through(await home.forwarded_port("office", "master", "/master"))
            assert stream.peer.name == "/remote/office/master"
            with pytest.raises(ChannelError):
                await home.through(await home.forwarded_port("office", "node", "/robot"))
            tell(office, home)
            trust_status = office.member.trust_status
            await until(lambda: getattr(trust_status.foreign(home.domain), "current", None))
            await (await home.through(await home.forwarded_port("office", "node", "/robot"))).close()
            await stream.close()


async def test_the_file_of_peers_may_be_damaged_for_a_while(
    sites: Sites, caplog: pytest.LogCaptureFixture
) -> None:
    home, _ = sites
    path = home.files.home.path / "overlay.json"
    before = path.read_bytes()
    path.write_bytes(b"{}")
    await until(lambda: "this is no rossec-overlay file" in str(home.relay.status()["problem"]))
    assert peer_of(home)["label"] == "office"
    path.write_bytes(before)
    await until(lambda: home.relay.status()["problem"] == "")
    assert caplog.text.count("this is no rossec-overlay file") == 1


async def test_a_router_that_is_gone_is_told_once(sites: Sites, caplog: pytest.LogCaptureFixture) -> None:
    home, _ = sites
    home.network.router = ""
    await until(lambda: f"no router takes the account {home.network.account}" in caplog.text)
    home.network.router = "tls/203.0.113.11:7447"
    await until(lambda: "router tls/203.0.113.11:7447 is in use now" in caplog.text)
    assert caplog.text.count("no router takes the account") == 1


async def test_a_service_has_a_forwarded_port_of_its_own(sites: Sites) -> None:
    home, office = sites
    office.site.grant("/robot", Right.PROVIDE, "/robot/stop")

    async def stop(request: object) -> object:
        raise NotImplementedError

    async with office.master.node("/robot") as robot:
        await robot.service("/robot/stop", "std_srvs/Empty", stop)
        forwarded_port = await home.forwarded_port("office", "service", "/robot/stop")
        stream = await home.through(forwarded_port, protocol=WireProtocol.TCPROS)
        assert stream.peer.name == "/remote/office/robot"
        await stream.close()


async def test_a_peer_that_makes_link_after_link_has_the_newest_two(sites: Sites) -> None:
    home, office = sites
    key = office.relay_inbox(home)
    made = []
    for _ in range(4):
        made.append(await home.network.dial(key))
        await until(lambda: made and peer_of(office)["called"] == min(len(made), 2))
    for stream in made[:2]:
        await ended(stream)
    for stream in made[2:]:
        assert stream.error is None
        stream.abort("done")


async def test_a_crash_of_a_part_ends_the_relay(sites: Sites) -> None:
    home, _ = sites
    stream = await home.through(await home.forwarded_port("office", "master", "/master"))
    home.member.crashed(RuntimeError("a bug"))
    await ended(stream)
    assert home.running is not None
    with pytest.raises(RuntimeError, match="a bug"):
        await home.running


async def test_masters_that_follow_each_other_by_relays_bring_messages(tmp_path: Path) -> None:
    """Nothing is known at first: lists, revocations, facts and messages all come this way."""
    async with two_sites(tmp_path, told=False) as (home, office):
        both = home, office
        for one, other in (both, both[::-1]):
            site = SiteSettings(other.label, "", "/master", other.label, via=other.label)
            one.master.follow(site)
        office.site.publish("/robot", "/robot/pose")
        accept(office.site, home.site, "home")  # what it calls the subject of grants
        home.site.enroll("/watcher")
        share(office.site, home.site, "/watcher", Right.SUBSCRIBE, "/robot/pose")
        share(office.site, home.site, "/master", Right.GRAPH, "/**")
        async with office.master.node("/robot") as robot, home.master.node("/watcher") as watcher:
            publisher = await robot.publisher("/robot/pose", "std_msgs/String", latch=True)
            subscriber = await watcher.subscriber("/remote/office/robot/pose", "std_msgs/String")
            publisher.publish(publisher.create(data="hello"))
            async with asyncio.timeout(30):
                async for message in subscriber:
                    assert message.data == "hello"
                    break

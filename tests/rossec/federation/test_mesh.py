import asyncio
import contextlib
import logging
from collections.abc import AsyncIterator
from pathlib import Path

import pytest

from rossec.federation.follower import FollowedSite
from rossec.federation.mesh import AnnouncedMasters, mesh_of
from rossec.federation.settings import FILE, FederationConfig, SiteFile, SiteSettings
from rossec.master.state.forwarded_ports import SILENCE, PeerWay, RelayReport
from tests.support.masters import Master, masters
from tests.support.site import Site
from tests.support.witness import until


@pytest.fixture
async def pair(tmp_path: Path) -> AsyncIterator[list[Master]]:
    async with masters(Site(tmp_path / "site"), "/master", "/master/kitchen") as found:
        yield found


async def test_a_site_added_to_the_file_is_followed_and_removed_again(pair: list[Master]) -> None:
    hall, kitchen = pair
    await kitchen.register("/robot", "/pose", 4711)
    hall.want()
    hall.follow()
    site = kitchen.as_site("kitchen")
    SiteFile(hall.home.path).change(lambda sites: sites.update(kitchen=site))
    await until(lambda: hall.imported("/pose"))
    assert hall.state_of("kitchen")["source"] == "file"
    assert hall.server.state.trust.domains.domain_of("kitchen") == ""
    SiteFile(hall.home.path).change(dict.clear)
    await until(lambda: not hall.imported("/pose"))
    assert hall.mesh.status() == {"sites": [], "problems": {}}
    assert hall.server.state.trust.domains.domain_of("kitchen") is None


async def test_the_configuration_prevails_and_the_rest_is_said(pair: list[Master]) -> None:
    hall, kitchen = pair
    wrong = SiteSettings("kitchen", "http://127.0.0.1:1/", "/master/cellar")
    SiteFile(hall.home.path).change(lambda sites: sites.update(kitchen=wrong))
    hall.follow(kitchen.as_site("kitchen"), SiteSettings("hospital", "http://h:1/", domain="h"))
    await until(lambda: hall.state_of("kitchen")["state"] == "following")
    assert hall.state_of("kitchen")["source"] == "configuration"
    problems = hall.mesh.status()["problems"]
    assert "two sites are called kitchen" in problems["site kitchen"]
    assert "h is not a domain that is trusted" in problems["site hospital"]


async def test_a_damaged_file_changes_nothing(pair: list[Master]) -> None:
    hall, kitchen = pair
    site = kitchen.as_site("kitchen")
    SiteFile(hall.home.path).change(lambda sites: sites.update(kitchen=site))
    hall.follow()
    await until(lambda: hall.state_of("kitchen")["state"] == "following")
    (hall.home.path / FILE).write_text("{")
    await until(lambda: hall.mesh.status()["problems"])
    assert FILE in hall.mesh.status()["problems"]["file"]
    assert hall.state_of("kitchen")["state"] == "following"


async def test_a_master_does_not_follow_itself(pair: list[Master]) -> None:
    hall, _ = pair
    hall.follow(hall.as_site("hall"))
    await until(lambda: hall.mesh.status()["problems"])
    assert "/master is this master itself" in hall.mesh.status()["problems"]["site hall"]
    assert hall.mesh.status()["sites"] == []


async def test_a_round_that_fails_is_not_the_last(
    pair: list[Master], monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    hall, kitchen = pair
    hall.follow(kitchen.as_site("kitchen"))
    await until(lambda: hall.state_of("kitchen")["state"] == "following")
    failures = iter([RuntimeError("once")])

    def tick(_site: FollowedSite) -> None:
        for error in failures:
            raise error

    monkeypatch.setattr(FollowedSite, "tick", tick)
    await until(lambda: "a round failed" in caplog.text)
    site = kitchen.as_site("kitchen2")
    SiteFile(hall.home.path).change(lambda sites: sites.update(kitchen2=site))
    await until(lambda: "one master" in str(hall.mesh.status()["problems"]))


async def test_what_was_wrong_is_said_once_and_while_it_is(
    pair: list[Master], caplog: pytest.LogCaptureFixture
) -> None:
    hall, kitchen = pair
    site, file = kitchen.as_site("kitchen"), SiteFile(hall.home.path)
    file.change(lambda sites: sites.update(kitchen=site))
    hall.follow(site)  # the configuration has the label too
    await until(lambda: "site kitchen" in hall.mesh.status()["problems"])
    for word in ("a", "b"):  # two more rounds
        other = SiteSettings(word, "http://127.0.0.1:1", "/master", word)
        file.change(lambda sites, other=other: sites.update({other.label: other}))  # type: ignore[misc]
        await until(lambda word=word: f"site {word}" in hall.mesh.status()["problems"])  # type: ignore[misc]
    assert caplog.text.count("site kitchen: ") == 1
    file.change(dict.clear)
    await until(lambda: not hall.mesh.status()["problems"])


async def test_a_master_that_was_named_and_is_heard_too_is_no_contradiction(
    pair: list[Master], monkeypatch: pytest.MonkeyPatch
) -> None:
    hall, kitchen = pair
    heard = (kitchen.as_site("kitchen"), SiteSettings("attic", "http://127.0.0.1:1", "/master/a"))
    monkeypatch.setattr(AnnouncedMasters, "sites", lambda _: heard)
    monkeypatch.setattr(AnnouncedMasters, "listening", lambda _: contextlib.nullcontext())
    config = FederationConfig(follow_announced=True, sites=(kitchen.as_site("galley"),))
    mesh = mesh_of(hall.server, hall.home, config)
    running = asyncio.ensure_future(mesh.run())
    try:
        await until(lambda: len(mesh.status()["sites"]) == 2)
    finally:
        running.cancel()
    assert [(s["label"], s["source"]) for s in mesh.status()["sites"]] == [
        ("attic", "announced"),
        ("galley", "configuration"),
    ]
    assert mesh.status()["problems"] == {}


async def test_a_relay_is_told_the_masters_that_it_can_reach_itself(pair: list[Master]) -> None:
    hall, kitchen = pair
    office = SiteSettings("office", "", "/master/office", via="office")
    hall.follow(kitchen.as_site("kitchen"), office)
    forwarded_ports = hall.server.state.forwarded_ports
    await until(lambda: forwarded_ports.masters() == {"/master/kitchen": kitchen.server.uri})


async def test_a_relay_that_fell_silent_is_forgotten(
    pair: list[Master], caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.WARNING, "rossec.audit")
    hall, _ = pair
    forwarded_ports, now = hall.server.state.forwarded_ports, hall.server.state.now()
    way = {"office": PeerWay("up", 1.0, 0, "", 0)}
    forwarded_ports.hear("/relay", RelayReport("one", 0, {}, way), now - SILENCE - 1)
    hall.follow()
    await until(lambda: forwarded_ports.way("office") is None)
    assert "relay /relay is silent" in caplog.text

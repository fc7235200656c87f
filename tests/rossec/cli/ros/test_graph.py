"""`rossec graph`: one look, and following a master through its restart."""

import asyncio
import contextlib
import json
import time
from pathlib import Path
from typing import Any

import pytest

from ca.errors import HintedError
from grants.model import Right
from rossec.cli.main import run
from rossec.cli.ros import graph as module
from rossec.cli.ros.graph import describe
from rossec.cli.shared.context import Environment
from rossec.errors import ConfigurationError
from rossec.home import NodeHome
from tests.rossec.participant.test_identity_renewal import BEGIN, below
from tests.support.site import DAY, Site

POSE = "geometry_msgs/PoseStamped"


@pytest.fixture
def site(tmp_path: Path) -> Site:
    site = Site(tmp_path / "site")
    site.publish("/robot", "/robot/pose")
    site.grant("/desk", Right.GRAPH, "/**")
    return site


async def look(site: Site, *options: str) -> int:
    arguments = ["graph", "--as", "/desk", *options]
    return await asyncio.to_thread(run, arguments, dict(site.environ))


async def test_the_graph_is_printed_once(site: Site, capsys: pytest.CaptureFixture[str]) -> None:
    async with site.running(), site.node("/robot") as robot:
        await robot.publisher("/robot/pose", POSE)
        capsys.readouterr()
        assert await look(site) == 0
        assert capsys.readouterr().out == f"/robot/pose ({POSE})\n  published by /robot\n"
        assert await look(site, "--json") == 0
        said = json.loads(capsys.readouterr().out)
        assert ["publisher", "/robot/pose", "/robot"] in said["added"]
        assert len(said["instance"]) == 16
        assert said["version"] > 0


def test_the_graph_is_printed_as_text() -> None:
    lines = describe(
        frozenset(
            {
                ("publisher", "/t", "/b"),
                ("publisher", "/t", "/a"),
                ("subscriber", "/t", "/c"),
                ("type", "/t", "pkg/T"),
                ("subscriber", "/u", "/c"),
                ("service", "/s", "/a"),
                ("node", "/a", "http://a:1/"),
                ("provider", "/s", "rosrpc://a:2"),
            }
        )
    )
    assert lines == [
        "/t (pkg/T)",
        "  published by /a, /b",
        "  subscribed by /c",
        "/u",
        "  subscribed by /c",
        "/s provided by /a",
    ]


async def until(holds: Any) -> None:
    async with asyncio.timeout(20):
        while not holds():  # noqa: ASYNC110 - nothing tells
            await asyncio.sleep(0.01)


@pytest.mark.parametrize("as_json", [False, True])
async def test_following_a_master_through_its_restart(
    site: Site, monkeypatch: pytest.MonkeyPatch, as_json: bool
) -> None:
    said: list[str] = []
    notes: list[str] = []
    monkeypatch.setattr(module, "say", said.append)
    monkeypatch.setattr(module, "say_json", lambda value: said.append(json.dumps(value)))
    monkeypatch.setattr(module, "note", notes.append)
    monkeypatch.setattr(module, "PAUSE", 0.05)
    async with site.running():
        assert site.master is not None
        following = asyncio.ensure_future(
            module._print_changes(
                Environment(site.environ), NodeHome.of(site.root, "/desk"), site.master.uri, as_json
            )
        )
        async with site.node("/robot") as robot:
            await robot.publisher("/robot/pose", POSE)
            await until(lambda: "publisher" in "".join(said))
            await site.restart_master()
            await until(lambda: any("no graph changes received" in text for text in notes))
            if as_json:
                await until(lambda: any(json.loads(line)["restarted"] for line in said))
            else:
                await until(lambda: "the master has restarted" in notes)
        said.clear()
        following.cancel()


async def follow(site: Site) -> None:
    assert site.master is not None
    home = NodeHome.of(site.root, "/desk")
    await module._print_changes(Environment(site.environ), home, site.master.uri, as_json=False)


async def test_watching_renews_the_identity(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    site, said = Site(tmp_path / "old", clock=lambda: BEGIN), list[str]()
    monkeypatch.setattr(module, "say", said.append)
    for name in ("/desk", "/robot", "/master"):
        site.enroll(name, 20 * DAY)
    site.grant("/desk", Right.GRAPH, "/**", lifetime=20 * DAY)
    site.publish("/robot", "/robot/pose", lifetime=20 * DAY)
    site._clock = time.time
    site.intermediate = below(site)
    home = NodeHome.of(site.root, "/desk")
    before = home.identity(int(time.time())).not_after
    async with site.running():
        following = asyncio.ensure_future(follow(site))
        await until(lambda: home.identity(int(time.time())).not_after > before or following.done())
        async with site.node("/robot") as robot:
            await robot.publisher("/robot/pose", POSE)
            await until(lambda: "publisher" in "".join(said) or following.done())
        assert not following.done()
        following.cancel()


async def test_watching_ends_with_the_identity(site: Site, monkeypatch: pytest.MonkeyPatch) -> None:
    """It said the same line every second, for ever."""
    said = list[str]()
    monkeypatch.setattr(module, "say", said.append)
    site.publish("/robot", "/robot/pose")
    async with site.running(), site.node("/robot") as robot:
        await robot.publisher("/robot/pose", POSE)
        following = asyncio.ensure_future(follow(site))
        await until(lambda: "publisher" in "".join(said))
        monkeypatch.setattr(module, "now", lambda: int(time.time()) + 2 * DAY)
        await site.restart_master()
        with pytest.raises(
            ConfigurationError, match=r"the identity of /desk ended on .*, and it was not renewed"
        ) as caught:
            await asyncio.wait_for(following, 20)
    assert "rossec ca renew --expired /desk" in caught.value.hint


async def test_the_same_error_is_printed_once(site: Site, monkeypatch: pytest.MonkeyPatch) -> None:
    notes, said, tries = list[str](), list[str](), list[int]()

    class Unreachable(contextlib.nullcontext[None]):
        async def __aenter__(self) -> None:
            tries.append(1)
            raise OSError("out of reach")

    monkeypatch.setattr(module, "note", notes.append)
    monkeypatch.setattr(module, "say", said.append)
    monkeypatch.setattr(module, "PAUSE", 0.01)
    monkeypatch.setattr(module, "MAX_PAUSE", 0.04)
    site.publish("/robot", "/robot/pose")
    async with site.running(), site.node("/robot") as robot:
        await robot.publisher("/robot/pose", POSE)
        following = asyncio.ensure_future(follow(site))
        await until(lambda: "publisher" in "".join(said))
        monkeypatch.setattr(module, "calls_as", lambda *_: Unreachable())
        await site.restart_master()
        await until(lambda: len(tries) > 5)
        following.cancel()
    assert sum("out of reach" in text for text in notes) == 1


async def test_without_a_master_watching_fails(site: Site) -> None:
    with pytest.raises(HintedError):
        await module._print_changes(
            Environment(site.environ), site.enroll("/desk"), "http://127.0.0.1:1/", as_json=False
        )


def test_names_of_other_origins_are_printed_with_their_label() -> None:
    """Own names first; a machine gets the local names."""
    pose, robot = "/remote/hospital/robot/pose", "/remote/hospital/robot"
    facts = frozenset(
        {
            ("publisher", pose, robot),
            ("subscriber", pose, "/viewer"),
            ("type", pose, POSE),
            ("publisher", "/word", "/remote/kitchen/robot"),
            ("service", "/say", "/robot"),
            ("service", "/remote/hospital/lamp", robot),
        }
    )
    assert describe(facts) == [
        "/word",
        "  published by kitchen:/robot",
        f"hospital:/robot/pose ({POSE})",
        "  published by hospital:/robot",
        "  subscribed by /viewer",
        "/say provided by /robot",
        "hospital:/lamp provided by hospital:/robot",
    ]

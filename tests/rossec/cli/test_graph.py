"""`rossec graph`: one look, and following a master through its restart."""

import asyncio
import json
from pathlib import Path
from typing import Any

import pytest

from ca.errors import HintedError
from grants.model import Right
from rossec.cli import graph as module
from rossec.cli.context import Environment
from rossec.cli.graph import describe
from rossec.cli.main import run
from rossec.home import NodeHome
from tests.support.site import Site

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


async def test_one_look(site: Site, capsys: pytest.CaptureFixture[str]) -> None:
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


def test_the_graph_in_words() -> None:
    lines = describe(
        frozenset(
            {
                ("publisher", "/t", "/b"), ("publisher", "/t", "/a"), ("subscriber", "/t", "/c"),
                ("type", "/t", "pkg/T"), ("subscriber", "/u", "/c"), ("service", "/s", "/a"),
                ("node", "/a", "http://a:1/"), ("provider", "/s", "rosrpc://a:2"),
            }
        )
    )  # fmt: skip
    assert lines == [
        "/t (pkg/T)", "  published by /a, /b", "  subscribed by /c", "/u", "  subscribed by /c",
        "/s provided by /a",
    ]  # fmt: skip


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
    monkeypatch.setattr(module, "_PAUSE", 0.05)
    async with site.running():
        assert site.master is not None
        following = asyncio.ensure_future(
            module._follow(
                Environment(site.environ), NodeHome.of(site.root, "/desk"), site.master.uri, as_json
            )
        )
        async with site.node("/robot") as robot:
            await robot.publisher("/robot/pose", POSE)
            await until(lambda: "publisher" in "".join(said))
            await site.restart_master()
            await until(lambda: any("no news of the graph" in text for text in notes))
            if as_json:
                await until(lambda: any(json.loads(line)["restarted"] for line in said))
            else:
                await until(lambda: "the master has begun anew" in notes)
        said.clear()
        following.cancel()


async def test_nobody_to_follow(site: Site) -> None:
    with pytest.raises(HintedError):
        await module._follow(
            Environment(site.environ), site.enroll("/desk"), "http://127.0.0.1:1/", as_json=False
        )

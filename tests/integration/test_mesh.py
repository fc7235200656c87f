"""Hosts of several domains with masters of their own; cut links, dead and suspended masters."""

import time
from collections.abc import AsyncIterator
from pathlib import Path

import pytest

from tests.support.lan import lan_of
from tests.support.mesh import Mesh, mesh_of

POSE = "/robot/pose"


@pytest.fixture
async def two(tmp_path: Path) -> AsyncIterator[Mesh]:
    """Two domains with one master each."""
    async with mesh_of({"home": ("hall",), "hospital": ("ward",)}, tmp_path) as mesh:
        for domain in mesh.domains.values():
            domain.enroll("/robot", publish=POSE)
            domain.enroll("/viewer", subscribe=POSE)
        yield mesh


def test_without_namespaces_nothing_is_cut(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    refusing = tmp_path / "unshare"
    refusing.write_text("#!/bin/sh\nexit 1\n")
    refusing.chmod(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path}:/usr/bin:/bin:/usr/sbin")
    with lan_of({"home": ("hall", "kitchen")}) as lan:
        assert not lan.real
        assert lan["kitchen"].ipv4 == "127.0.0.2"
        with pytest.raises(AssertionError, match="no link can be cut"):
            lan.cut("hall")


async def test_nodes_go_on_while_their_master_is_dead_or_suspended(two: Mesh) -> None:
    """The same names in two domains that know nothing of each other do not meet."""
    for place in two.places.values():
        await place.begin()
        await place.crew.publish("/robot", POSE)
        await place.crew.subscribe("/viewer", POSE)
    for place in two.places.values():
        await place.crew.hears("/viewer", POSE)
        state = await place.see()
        assert state == [[[POSE, ["/robot"]]], [[POSE, ["/viewer"]]], []]
    since = time.time()
    hall, ward = two["hall"], two["ward"]
    with ward.paused():
        await hall.kill()
        await hall.crew.hears("/viewer", POSE)
        await ward.crew.hears("/viewer", POSE)
        await hall.start()
    for place in two.places.values():
        assert place.crew.longest_gap("/viewer", POSE, since) < 1

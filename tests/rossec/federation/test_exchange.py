from collections.abc import AsyncIterator
from pathlib import Path

import pytest

from tests.support.masters import Master, domain_list, masters
from tests.support.site import Site
from tests.support.witness import until

NAMES = "/master", "/master/kitchen", "/master/hall"
WITHIN = 3.0  # seconds; a second is promised, and these tests share a machine


@pytest.fixture
async def pair(tmp_path: Path) -> AsyncIterator[list[Master]]:
    async with masters(Site(tmp_path / "site"), *NAMES[:2]) as found:
        yield found


async def followed(by: Master, label: str) -> None:
    await until(lambda: by.state_of(label)["state"] == "following")


@pytest.mark.parametrize("at", [0, 1])
async def test_a_new_list_at_one_is_at_the_other_at_once(pair: list[Master], at: int) -> None:
    """Only one of them follows the other."""
    hall, kitchen = pair
    hall.follow(kitchen.as_site("kitchen"))
    await followed(hall, "kitchen")
    data = hall.site.revoke(hall.site.identity("/master").thumbprint[::-1])
    pair[at].take_list(data)
    await until(lambda: hall.list_number == kitchen.list_number == (1, 2), within=WITHIN)


@pytest.mark.parametrize("at", [0, 1])
async def test_a_master_with_an_older_list_gets_the_newest_when_they_meet(
    pair: list[Master], at: int
) -> None:
    hall, kitchen = pair
    pair[at].take_list(hall.site.revoke(b"k" * 32))
    hall.follow(kitchen.as_site("kitchen"))
    await until(lambda: hall.list_number == kitchen.list_number == (1, 2), within=WITHIN)
    await followed(hall, "kitchen")


@pytest.mark.parametrize("at", [0, 1])
async def test_trees_too(pair: list[Master], at: int, monkeypatch: pytest.MonkeyPatch) -> None:
    hall, kitchen = pair
    hall.follow(kitchen.as_site("kitchen"))
    kitchen.follow(hall.as_site("hall"))
    await followed(hall, "kitchen")
    await followed(kitchen, "hall")
    monkeypatch.setattr("rossec.authority.signing.MAX_ENTRIES", 0)
    data = hall.site.revoke(b"k" * 32)
    entries = hall.site.entries
    assert entries is not None
    pair[at].take_tree(data, entries)
    await until(lambda: hall.list_number == kitchen.list_number == (1, 2), within=WITHIN)
    assert hall.server.state.trust.tree_entries == kitchen.server.state.trust.tree_entries


@pytest.mark.parametrize("at", [0, 1])
async def test_a_list_of_domains(pair: list[Master], at: int) -> None:
    hall, kitchen = pair
    hall.follow(kitchen.as_site("kitchen"))
    await followed(hall, "kitchen")
    data = domain_list(hall.site, *NAMES[:2], seq=2)
    pair[at].take_domains(data)
    held = [master.server.state.trust.domains.anchors for master in pair]
    await until(lambda: held[0].data == held[1].data == data, within=WITHIN)


async def test_a_list_reaches_every_master_of_a_chain(tmp_path: Path) -> None:
    async with masters(Site(tmp_path / "site"), *NAMES) as (first, second, third):
        first.follow(second.as_site("second"))
        second.follow(third.as_site("third"))
        await followed(first, "second")
        await followed(second, "third")
        third.take_list(first.site.revoke(b"k" * 32))
        await until(lambda: first.list_number == (1, 2), within=WITHIN)


async def test_a_revoked_master_is_followed_no_longer(pair: list[Master]) -> None:
    hall, kitchen = pair
    await kitchen.register("/robot", "/pose", 4711)
    hall.want()
    hall.follow(kitchen.as_site("kitchen"))
    await until(lambda: hall.imported("/pose"))
    hall.take_list(hall.site.revoke(hall.site.identity("/master/kitchen").thumbprint))
    await until(lambda: not hall.imported("/pose"), within=WITHIN)
    await until(lambda: "revoked" in hall.state_of("kitchen")["error"])

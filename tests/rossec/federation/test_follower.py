import asyncio
from collections.abc import AsyncIterator
from pathlib import Path

import pytest

from grants.model import Right
from rossec.federation import site_state
from rossec.federation.follower import PACE
from rossec.federation.site_state import SiteCursor
from rossec.master.server import answers as server_answers
from tests.support.masters import Master, masters
from tests.support.site import Site
from tests.support.witness import until


@pytest.fixture
async def pair(tmp_path: Path) -> AsyncIterator[list[Master]]:
    async with masters(Site(tmp_path / "site"), "/master", "/master/kitchen") as found:
        for master in found:
            master.want()
        yield found


async def test_facts_of_another_master_come_and_go(pair: list[Master]) -> None:
    hall, kitchen = pair
    await kitchen.register("/robot", "/pose", 4711)
    hall.follow(kitchen.as_site("kitchen"))
    await until(lambda: hall.imported("/pose") == ["http://127.0.0.1:4711/"])
    await kitchen.register("/arm", "/arm/pose", 4712)
    await until(lambda: hall.imported("/arm/pose") == ["http://127.0.0.1:4712/"])
    kitchen.unregister("/robot")
    await until(lambda: hall.imported("/pose") == [])
    assert hall.state_of("kitchen")["state"] == "following"
    assert hall.state_of("kitchen")["error"] == ""
    assert hall.state_of("kitchen")["facts"] == 3
    assert kitchen.imported("/pose") == []


async def test_both_ways_without_a_loop(pair: list[Master]) -> None:
    hall, kitchen = pair
    await hall.register("/robot", "/pose", 4711)
    await kitchen.register("/arm", "/arm/pose", 4712)
    hall.follow(kitchen.as_site("kitchen"))
    kitchen.follow(hall.as_site("hall"))
    await until(lambda: hall.imported("/arm/pose"))
    await until(lambda: kitchen.imported("/pose"))
    assert hall.state_of("kitchen")["facts"] == kitchen.state_of("hall")["facts"] == 3


async def test_a_restarted_master_is_followed_again(pair: list[Master]) -> None:
    hall, kitchen = pair
    await kitchen.register("/robot", "/pose", 4711)
    hall.follow(kitchen.as_site("kitchen"))
    await until(lambda: hall.imported("/pose"))
    await kitchen.stop()
    await until(lambda: hall.state_of("kitchen")["state"] in ("lost", "dialling"))
    assert hall.imported("/pose"), "its facts stay for a minute"
    assert hall.state_of("kitchen")["lost_s"] is not None
    await kitchen.start()
    await kitchen.register("/arm", "/arm/pose", 4712)
    await until(lambda: hall.imported("/arm/pose"))
    assert hall.imported("/pose") == [], "what the new run does not know is gone"


async def test_the_facts_of_a_lost_master_go(pair: list[Master], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(site_state, "LOST_FOR", 1.5)
    hall, kitchen = pair
    await kitchen.register("/robot", "/pose", 4711)
    hall.follow(kitchen.as_site("kitchen"))
    await until(lambda: hall.imported("/pose"))
    await kitchen.stop()
    await asyncio.sleep(0.5)
    assert hall.imported("/pose")
    await until(lambda: not hall.imported("/pose"))
    assert hall.state_of("kitchen")["facts"] == 0
    await kitchen.start()
    await kitchen.register("/robot", "/pose", 4711)
    await until(lambda: hall.imported("/pose"))


async def test_another_master_than_expected_is_refused(pair: list[Master]) -> None:
    hall, kitchen = pair
    kitchen.name = "/master/cellar"
    hall.follow(kitchen.as_site("cellar"))
    await until(lambda: hall.state_of("cellar")["error"])
    assert "/master/kitchen answers at" in hall.state_of("cellar")["error"]
    assert hall.state_of("cellar")["state"] in ("idle", "dialling")


async def test_facts_travel_by_need(tmp_path: Path) -> None:
    async with masters(Site(tmp_path / "site"), "/master", "/master/kitchen") as (hall, kitchen):
        await kitchen.register("/robot", "/pose", 4711)
        await kitchen.register("/arm", "/arm/pose", 4712)
        hall.follow(kitchen.as_site("kitchen"))
        await until(lambda: hall.state_of("kitchen")["state"] == "following")
        assert hall.state_of("kitchen")["facts"] == 0
        hall.want("/pose")
        await until(lambda: hall.imported("/pose"), within=3)
        assert not hall.imported("/arm/pose")
        hall.want()
        await until(lambda: hall.imported("/arm/pose"), within=3)
        assert hall.state_of("kitchen")["error"] == ""


async def test_a_site_that_answers_at_once_is_asked_in_measure(
    pair: list[Master], monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[float] = []
    take = SiteCursor.take

    def counted(cursor: SiteCursor, answer: object) -> object:
        asked.append(asyncio.get_running_loop().time())
        return take(cursor, answer)

    monkeypatch.setattr(SiteCursor, "take", counted)
    monkeypatch.setattr(server_answers, "WATCH_WAIT", 0.0)
    hall, kitchen = pair
    hall.follow(kitchen.as_site("kitchen"))
    await until(lambda: len(asked) > 10)
    assert asked[10] - asked[1] >= 8 * PACE


async def test_an_error_of_another_kind_does_not_end_it(
    pair: list[Master], monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    take = SiteCursor.take
    failures = iter([ValueError("first"), RecursionError("second")])

    def taken(cursor: SiteCursor, answer: object) -> object:
        for error in failures:
            raise error
        return take(cursor, answer)

    monkeypatch.setattr(SiteCursor, "take", taken)
    hall, kitchen = pair
    await kitchen.register("/robot", "/pose", 4711)
    hall.follow(kitchen.as_site("kitchen"))
    await until(lambda: hall.imported("/pose"))
    assert "following site kitchen failed" in caplog.text


async def test_a_site_that_is_revoked_while_its_answer_is_waited_for(pair: list[Master]) -> None:
    hall, kitchen = pair
    await kitchen.register("/robot", "/pose", 4711)
    hall.follow(kitchen.as_site("kitchen"))
    await until(lambda: hall.imported("/pose"))
    await asyncio.sleep(0.2)  # nothing has changed: the next answer comes after five seconds
    hall.take_list(hall.site.revoke(hall.site.identity("/master/kitchen").thumbprint))
    await until(lambda: not hall.imported("/pose"), within=2)
    await until(lambda: "revoked" in hall.state_of("kitchen")["error"])


async def test_a_site_with_more_facts_than_the_limit_is_not_followed(pair: list[Master]) -> None:
    hall, kitchen = pair
    await kitchen.register("/robot", "/pose", 4711)
    hall.server.state.imports._limit = 1
    hall.follow(kitchen.as_site("kitchen"))
    await until(lambda: "more than 1 facts" in hall.state_of("kitchen")["error"])
    assert hall.imported("/pose") == []
    assert hall.state_of("kitchen")["facts"] == 0


async def test_a_site_whose_parameters_are_mirrored_is_shown_the_own_grants(pair: list[Master]) -> None:
    hall, kitchen = pair
    hall.site.grant("/master", Right.PARAM_GET, "/robot/**")
    await kitchen.register("/robot", "/pose", 4711)
    hall.follow(kitchen.as_site("kitchen", "", "/robot/**"))
    await until(lambda: hall.imported("/pose"))
    asked = kitchen.server.state.trust.caller(hall.site.identity("/master"), hall.site.now())
    assert asked.may(Right.PARAM_GET, "/robot/speed")
    assert hall.state_of("kitchen")["parameters"] == ["/robot/**"]


async def test_a_newer_list_goes_to_a_site_whose_answer_is_waited_for(pair: list[Master]) -> None:
    hall, kitchen = pair
    hall.follow(kitchen.as_site("kitchen"))
    await until(lambda: hall.state_of("kitchen")["state"] == "following")
    await asyncio.sleep(0.2)
    hall.take_list(hall.site.revoke(b"k" * 32))
    await until(lambda: kitchen.list_number == (1, 2), within=3)


async def test_a_site_that_is_followed_no_longer_leaves_nothing(pair: list[Master]) -> None:
    hall, kitchen = pair
    await kitchen.register("/robot", "/pose", 4711)
    mesh = hall.follow(kitchen.as_site("kitchen"))
    await until(lambda: hall.imported("/pose"))
    ((follower, _),) = mesh._followers.values()
    await follower.send_lists()
    assert hall.imported("/pose"), "the newer lists are settled beside it"
    follower.remove()
    assert not hall.imported("/pose")


async def test_a_site_that_was_lost_is_dialled_when_it_is_woken(
    pair: list[Master], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(site_state, "LOST_FOR", 0.2)
    hall, kitchen = pair
    await kitchen.register("/robot", "/pose", 4711)
    mesh = hall.follow(kitchen.as_site("kitchen"))
    await until(lambda: hall.imported("/pose"))
    await kitchen.stop()
    await until(lambda: not hall.imported("/pose"))
    ((follower, _),) = mesh._followers.values()
    assert follower.status()["error"]
    await kitchen.start()
    await kitchen.register("/robot", "/pose", 4711)
    follower.wake()
    await until(lambda: hall.imported("/pose"))
    assert follower.status()["error"] == ""

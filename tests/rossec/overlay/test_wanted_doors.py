"""What a master wants of its relay, and what it is told."""

from typing import Any

import pytest

from rossec.errors import AnswerMalformed
from rossec.master.state.forwarded_ports import MAX_DOORS, Door, Target
from rossec.overlay.wanted_ports import REPORTED_AT_ONCE, Orders, WantedDoors

ROBOT, ARM = Target("office", "node", "/robot"), Target("office", "node", "/arm")
AT = Door("127.0.0.1", 7001)


def answer(
    version: int, wanted: list[Target] | None = None, unwanted: list[Target] | None = None, **changes: Any
) -> dict[str, object]:
    return {
        "version": version,
        "wanted": [[*each] for each in wanted or []],
        "unwanted": [[*each] for each in unwanted or []],
        "masters": {},
        **changes,
    }


def test_a_door_is_opened_and_told_once() -> None:
    doors = WantedDoors()
    assert doors.take(answer(3, [ROBOT]), 0) == Orders((ROBOT,), (), {})
    assert (doors.seen, doors.report()) == (3, [])
    doors.opened(ROBOT, AT)
    assert doors.report() == [["office", "node", "/robot", "127.0.0.1", 7001]]
    assert doors.report(), "it is told again until there is an answer"
    doors.take(answer(3), 1)
    assert (doors.report(), doors.held) == ([], (ROBOT,))


def test_a_door_is_closed_that_is_wanted_no_longer() -> None:
    doors = WantedDoors()
    doors.take(answer(1, [ROBOT]), 0)
    doors.opened(ROBOT, AT)
    assert doors.take(answer(2, [], [ROBOT, ARM]), 0).close == (ROBOT,)
    assert (doors.held, doors.report()) == ((), [])


def test_after_a_new_connection_what_is_not_wanted_anew_is_closed() -> None:
    doors = WantedDoors()
    doors.take(answer(2, [ROBOT, ARM]), 0)
    doors.opened(ROBOT, AT)
    doors.opened(ARM, AT._replace(port=7002))
    doors.connected()
    assert (doors.seen, doors.report()) == (0, [])
    assert doors.take(answer(1, [ARM]), 0) == Orders((ARM,), (), {})
    doors.opened(ARM, AT._replace(port=7002))
    assert len(doors.report()) == 1
    assert doors.take(answer(1), 1).close == (ROBOT,)
    assert doors.take(answer(1), 0).close == ()
    assert doors.held == (ARM,)


def test_what_failed_is_tried_after_each_answer_until_it_is_wanted_no_longer() -> None:
    doors = WantedDoors()
    doors.take(answer(1, [ROBOT]), 0)
    assert doors.failed(ROBOT)
    assert doors.take(answer(1), 0).open == (ROBOT,)
    assert not doors.failed(ROBOT)
    assert doors.take(answer(2, [ROBOT]), 0).open == (ROBOT,)
    assert doors.take(answer(3, [], [ROBOT]), 0).open == ()
    doors.take(answer(4, [ARM]), 0)
    doors.failed(ARM)
    doors.opened(ARM, AT)
    assert doors.take(answer(4), 1).open == ()


def test_a_door_that_was_lost_is_opened_again() -> None:
    doors = WantedDoors()
    doors.take(answer(1, [ROBOT]), 0)
    doors.opened(ROBOT, AT)
    assert doors.lost([ROBOT, ARM]) == [ROBOT]
    assert (doors.held, doors.report()) == ((), [])
    assert doors.lost([ROBOT]) == []


def test_many_doors_are_told_in_parts() -> None:
    doors = WantedDoors()
    for number in range(REPORTED_AT_ONCE + 5):
        doors.opened(Target("office", "node", f"/n{number}"), Door("127.0.0.1", number + 1))
    first = doors.report()
    assert len(first) == REPORTED_AT_ONCE
    doors.take(answer(1), len(first))
    second = doors.report()
    assert [row[2] for row in second] == [f"/n{REPORTED_AT_ONCE + each}" for each in range(5)]


def test_masters_to_poll_too() -> None:
    masters = {"/master/kitchen": "http://kitchen:11311/"}
    assert WantedDoors().take(answer(1, masters=masters), 0).masters == masters


@pytest.mark.parametrize(
    "change",
    [
        {"version": "1"},
        {"more": 1},
        {"wanted": [["office", "node"]]},
        {"wanted": [["of fice", "node", "/a"]]},
        {"wanted": [["office", "topic", "/a"]]},
        {"unwanted": [["office", "node", "a"]]},
        {"masters": {"/robot": "http://r:1/"}},
        {"masters": {"/master": "ftp://r:1/"}},
        {"masters": {"/master": 7}},
        {"masters": []},
        {"masters": {f"/master/m{number}": "http://m:1/" for number in range(65)}},
        {"wanted": [["office", "node", f"/n{number}"] for number in range(MAX_DOORS + 1)]},
    ],
    ids=lambda change: str(change)[:60],
)
def test_a_malformed_answer_changes_nothing(change: dict[str, object]) -> None:
    doors = WantedDoors()
    doors.opened(ROBOT, AT)
    with pytest.raises(AnswerMalformed):
        doors.take({**answer(9), **change}, 1)
    assert (doors.seen, len(doors.report())) == (0, 1)

"""What a master wants of its relay, and what it is told."""

from typing import Any

import pytest

from rossec.errors import AnswerMalformed
from rossec.master.state.forwarded_ports import MAX_FORWARDED_PORTS, ForwardedPort, Target
from rossec.overlay.masters import REPORTED_AT_ONCE, Orders, WantedPorts

ROBOT, ARM = Target("office", "node", "/robot"), Target("office", "node", "/arm")
AT = ForwardedPort("127.0.0.1", 7001)


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


def test_a_forwarded_port_is_opened_and_told_once() -> None:
    forwarded_ports = WantedPorts()
    assert forwarded_ports.take(answer(3, [ROBOT]), 0) == Orders((ROBOT,), (), {})
    assert (forwarded_ports.seen, forwarded_ports.report()) == (3, [])
    forwarded_ports.opened(ROBOT, AT)
    assert forwarded_ports.report() == [["office", "node", "/robot", "127.0.0.1", 7001]]
    assert forwarded_ports.report(), "it is told again until there is an answer"
    forwarded_ports.take(answer(3), 1)
    assert (forwarded_ports.report(), forwarded_ports.held) == ([], (ROBOT,))


def test_a_forwarded_port_is_closed_that_is_wanted_no_longer() -> None:
    forwarded_ports = WantedPorts()
    forwarded_ports.take(answer(1, [ROBOT]), 0)
    forwarded_ports.opened(ROBOT, AT)
    assert forwarded_ports.take(answer(2, [], [ROBOT, ARM]), 0).close == (ROBOT,)
    assert (forwarded_ports.held, forwarded_ports.report()) == ((), [])


def test_after_a_new_connection_what_is_not_wanted_anew_is_closed() -> None:
    forwarded_ports = WantedPorts()
    forwarded_ports.take(answer(2, [ROBOT, ARM]), 0)
    forwarded_ports.opened(ROBOT, AT)
    forwarded_ports.opened(ARM, AT._replace(port=7002))
    forwarded_ports.connected()
    assert (forwarded_ports.seen, forwarded_ports.report()) == (0, [])
    assert forwarded_ports.take(answer(1, [ARM]), 0) == Orders((ARM,), (), {})
    forwarded_ports.opened(ARM, AT._replace(port=7002))
    assert len(forwarded_ports.report()) == 1
    assert forwarded_ports.take(answer(1), 1).close == (ROBOT,)
    assert forwarded_ports.take(answer(1), 0).close == ()
    assert forwarded_ports.held == (ARM,)


def test_what_failed_is_tried_after_each_answer_until_it_is_wanted_no_longer() -> None:
    forwarded_ports = WantedPorts()
    forwarded_ports.take(answer(1, [ROBOT]), 0)
    assert forwarded_ports.failed(ROBOT)
    assert forwarded_ports.take(answer(1), 0).open == (ROBOT,)
    assert not forwarded_ports.failed(ROBOT)
    assert forwarded_ports.take(answer(2, [ROBOT]), 0).open == (ROBOT,)
    assert forwarded_ports.take(answer(3, [], [ROBOT]), 0).open == ()
    forwarded_ports.take(answer(4, [ARM]), 0)
    forwarded_ports.failed(ARM)
    forwarded_ports.opened(ARM, AT)
    assert forwarded_ports.take(answer(4), 1).open == ()


def test_a_forwarded_port_that_was_lost_is_opened_again() -> None:
    forwarded_ports = WantedPorts()
    forwarded_ports.take(answer(1, [ROBOT]), 0)
    forwarded_ports.opened(ROBOT, AT)
    assert forwarded_ports.lost([ROBOT, ARM]) == [ROBOT]
    assert (forwarded_ports.held, forwarded_ports.report()) == ((), [])
    assert forwarded_ports.lost([ROBOT]) == []


def test_many_forwarded_ports_are_told_in_parts() -> None:
    forwarded_ports = WantedPorts()
    for number in range(REPORTED_AT_ONCE + 5):
        forwarded_ports.opened(
            Target("office", "node", f"/n{number}"), ForwardedPort("127.0.0.1", number + 1)
        )
    first = forwarded_ports.report()
    assert len(first) == REPORTED_AT_ONCE
    forwarded_ports.take(answer(1), len(first))
    second = forwarded_ports.report()
    assert [row[2] for row in second] == [f"/n{REPORTED_AT_ONCE + each}" for each in range(5)]


def test_masters_to_poll_too() -> None:
    masters = {"/master/kitchen": "http://kitchen:11311/"}
    assert WantedPorts().take(answer(1, masters=masters), 0).masters == masters


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
        {"wanted": [["office", "node", f"/n{number}"] for number in range(MAX_FORWARDED_PORTS + 1)]},
    ],
    ids=lambda change: str(change)[:60],
)
def test_a_malformed_answer_changes_nothing(change: dict[str, object]) -> None:
    forwarded_ports = WantedPorts()
    forwarded_ports.opened(ROBOT, AT)
    with pytest.raises(AnswerMalformed):
        forwarded_ports.take({**answer(9), **change}, 1)
    assert (forwarded_ports.seen, len(forwarded_ports.report())) == (0, 1)

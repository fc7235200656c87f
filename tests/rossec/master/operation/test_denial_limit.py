"""A node that causes many lines uses up its own limit, not that of others."""

import logging
from collections.abc import Mapping

import pytest

from rossec.host.audit import LEFT_OUT
from rossec.master.operation.admin import DENIALS, MAX_NODES, DenialRateLimit, denials_limited


class Lines:
    def __init__(self) -> None:
        self.now = 1000.0
        self.limit = DenialRateLimit(lambda: self.now)

    def __call__(self, node: object) -> bool:
        self.last = logging.makeLogRecord({"msg": "%s may not", "args": (node,)})
        return self.limit.filter(self.last)

    @property
    def left_out(self) -> int:
        return getattr(self.last, LEFT_OUT, 0)


@pytest.fixture
def lines() -> Lines:
    return Lines()


def test_each_node_has_its_own_limit(lines: Lines) -> None:
    assert sum(lines("/eve") for _ in range(500)) == 200
    assert lines("/robot")
    assert lines.left_out == 0
    lines.now += 1
    assert sum(lines("/eve") for _ in range(50)) == 10
    lines.now += 0.1
    assert lines("/eve")
    assert lines.left_out == 40  # since the last line with this number
    lines.now -= 5000  # a clock set back changes nothing
    assert not lines("/eve")
    lines.now += 6000
    assert sum(lines("/eve") for _ in range(500)) == 200


def test_the_lines_of_all_nodes_are_limited(lines: Lines) -> None:
    flood = [f"/n{number % 10}" for number in range(3000)]
    assert sum(map(lines, flood)) == 1000 + 10 * 10
    lines.now += 1
    assert sum(map(lines, flood)) == 50
    assert lines("/robot"), "what some have used up together is not its own"
    assert sum(lines("/robot") for _ in range(50)) == 9
    lines.now += 10
    assert sum(map(lines, flood)) == 500 + 10


def test_the_next_line_records_how_many_were_left_out(lines: Lines) -> None:
    for _ in range(203):
        lines("/eve")
    lines.now += 1
    assert lines("/eve")
    assert lines.left_out == 3
    assert lines("/eve")
    assert lines.left_out == 0


def test_the_number_of_nodes_is_bounded(lines: Lines) -> None:
    for number in range(MAX_NODES + 10):
        lines(f"/n{number}")
    assert len(lines.limit._nodes) == MAX_NODES


@pytest.mark.parametrize("args", [(), {"a": 1}])
def test_lines_without_a_node_are_limited(lines: Lines, args: tuple[()] | Mapping[str, object]) -> None:
    record = logging.makeLogRecord({"msg": "x", "args": args})
    assert sum(lines.limit.filter(record) for _ in range(500)) == 200


def test_the_logger_is_a_child_of_the_audits() -> None:
    assert logging.getLogger(DENIALS).parent is logging.getLogger("rossec.audit")


def test_denials_are_limited_while_the_context_lasts() -> None:
    log = logging.getLogger(DENIALS)
    filters = list(log.filters)
    with denials_limited():
        assert len(log.filters) == len(filters) + 1
    assert log.filters == filters

import json
import time
from collections import deque

import pytest

from rossec.cli.ros import graph
from rossec.discovery.announcement import Announcement, Candidate, DatagramSource
from tests.support.commands import Shell, refused


@pytest.fixture
def found(monkeypatch: pytest.MonkeyPatch) -> Candidate:
    """The one master that is found, on the link with the number 1."""
    announcement = Announcement("robot", 11311, bytes(8), 4, int(time.time()), 60)
    heard = deque([(1, time.monotonic() - 3), (4, time.monotonic())])
    one = Candidate(bytes(32), "/master", DatagramSource("10.0.0.7", 1), announcement, heard, 0.002)

    async def masters(*_: object) -> list[Candidate]:
        return [one]

    monkeypatch.setattr(graph, "masters", masters)
    return one


def test_a_master_is_shown_with_its_link(empty: Shell, found: Candidate) -> None:
    said = empty("discover")
    assert said.out.startswith("http://robot:11311  /master  2.0 ms, 50% of 4 lost, heard 0.")
    assert said.out.endswith(" s ago, on lo\n")


def test_a_master_is_a_line_of_json(empty: Shell, found: Candidate) -> None:
    row = json.loads(empty("discover", "--json").out)
    assert row.pop("age_s") < 60
    assert row == {
        "uri": "http://robot:11311",
        "name": "/master",
        "rtt_ms": 2.0,
        "loss": 0.5,
        "heard": 2,
        "sent": 4,
        "link": "lo",
        "key": "00" * 32,
    }


def test_without_an_enrolled_node_no_master_is_trusted(empty: Shell) -> None:
    refused(empty("discover", "--seconds", "0.1"), "enrolled")

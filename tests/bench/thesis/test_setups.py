"""One point in a real set-up: namespaces, a master, a publisher and six subscribers."""

from pathlib import Path

import pytest

from bench.thesis.latency import climb
from bench.thesis.network import NoNamespaces
from bench.thesis.setups import setup
from bench.thesis.talk import Point


def test_messages_are_counted_on_a_slow_link(tmp_path: Path) -> None:
    """Six copies of a message pass the publisher's link, and no slower than its rate permits."""
    try:
        with setup("direct_300k", tmp_path) as made:
            found = climb(made, [[Point(2000, 4, 4)]])
    except NoNamespaces as error:
        pytest.skip(f"NOT RUN: {error}")
    [row] = found["latency_ms"]
    assert row["arrived"] == 1
    assert row["last"] > 100  # 12 kB less the burst, at 37.5 kB/s
    assert 6 <= found["copies_on_link"].get("2000", 6) < 9

"""One point in real set-ups: namespaces, masters, gateways, a publisher, six subscribers."""

from pathlib import Path

import pytest

from bench.thesis import failures
from bench.thesis.latency import climb
from bench.thesis.network import NoNamespaces
from bench.thesis.table import setup
from bench.thesis.talk import Point


def test_one_copy_for_each_site_whose_gateway_ends_with_its_grant(tmp_path: Path) -> None:
    """Three subscribers are behind the slow link that is counted, and three behind another."""
    try:
        with setup("gateway_300k", tmp_path) as made:
            found = climb(made, [[Point(20_000, 1, 3)]])
            ended = failures.measure(made)
    except NoNamespaces as error:
        pytest.skip(f"NOT RUN: {error}")
    [row] = found["latency_ms"]
    assert row["arrived"] == 1
    assert 1 <= found["copies_on_link"].get("20000", 1) < 1.5
    assert ended["gateway_revocation_ms"] < 2000


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

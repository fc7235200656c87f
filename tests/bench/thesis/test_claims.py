"""The statements of thesis 5.2.5 as ratios."""

from bench.thesis.claims import EQUIVALENT, LARGEST, LATENCY, failed, judged, small
from bench.thesis.results import Measured

DIRECT = {"largest": 5000, "mean": 33.0, "low": 1.0, "spread": 93.0, "copies": 6.5}
ROUTED = {"largest": 20_000, "mean": 12.0, "low": 2.0, "spread": 20.0, "copies": 1.1}


def test_every_setup_has_a_figure_of_the_thesis() -> None:
    assert LARGEST.keys() == LATENCY.keys()
    assert set(EQUIVALENT.values()) <= LARGEST.keys()


def test_statements_hold_by_ratios() -> None:
    rows = {"direct_300k": DIRECT, "gateway_300k": ROUTED}
    found = judged(rows, "gateway")
    assert found["larger_300k"]["ratio"] == 4
    for name in ("larger_300k", "radio_no_slower", "radio_variance", "less_at_the_origin"):
        assert found[name]["holds"] is True
    assert failed({"statements": {"gateway": found}}) == []


def test_what_was_not_measured_neither_holds_nor_fails() -> None:
    found = judged({"direct_300k": DIRECT}, "gateway")
    assert {row["holds"] for row in found.values()} == {None}
    assert failed({"statements": {"gateway": found}}) == []


def test_a_statement_that_does_not_hold_is_named_with_its_ratio() -> None:
    rows = {"direct_300k": ROUTED, "relay_300k": DIRECT}
    reasons = failed({"statements": {"relay": judged(rows, "relay")}})
    assert "relay larger_300k: routed sends larger messages by radio: 0.25, not > 1" in reasons
    assert len(reasons) == 4


def test_pairs_through_relays_are_not_held_to_what_only_one_copy_gives() -> None:
    assert "larger_100m" in judged({}, "gateway")
    assert "larger_100m" not in judged({}, "relay")


def test_a_result_without_statements_has_nothing_that_failed() -> None:
    assert failed({}) == []


def test_small_messages_are_larger_by_radio() -> None:
    rows = [Measured(size, 10, size, 1, 3, 2, 1, 0) for size in (100, 1000)]
    assert small("relay_100m", rows) == {"mean": 100, "low": 1, "spread": 2}
    assert small("relay_300k", rows) == {"mean": 1000, "low": 1, "spread": 2}
    assert small("relay_300k", rows[:1]) == {}

"""The text of a result has the thesis's figure beside each of ours."""

from bench.thesis import combined, report
from bench.thesis.results import Measured


def made() -> dict[str, object]:
    rows = {
        name: {
            "largest": size,
            "copies": 3.0,
            "copies_on_link": {"1000": 3.0},
            "mean": 10.0,
            "spread": 5.0,
            "latency_ms": [
                Measured(100, 10, 2.5, 1, 4, 3, 1, 0).as_json(),
                Measured(10_000, 1, 900, 1, 4, 3, 0.5, 0).as_json(),
            ],
        }
        for name, size in (("direct_100m", 2_000_000), ("plain_100m", 1), ("relay_300k", 10_000))
    }
    memory = {"full": 67.0, "full_kb_a_node": 1.6, "master": 29.0, "sidecar": 26.0, "relay": 35.0}
    others = {"memory_mb": memory, "failures": {"revocation_ms": 109.0}, "mesh": {"2": {"a": 1}}}
    return combined(rows, others)


def test_ours_and_the_thesis_side_by_side() -> None:
    lines = {" ".join(line.split()) for line in report.text(made()).splitlines()}
    assert "direct_100m 2 MB thesis: 1 MB" in lines
    assert "relay_300k 10 kB thesis: 20 kB" in lines
    assert "gateway_300k not measured thesis: 20 kB" in lines
    assert "full 67.0, 1.6 kB thesis: 54.5 (full), 4.5 kB" in lines
    assert "master 29.0 thesis: -" in lines
    assert "100 B 10 Hz 2.5 (1.0 to 4.0)" in lines
    assert "10 kB 1 Hz 900.0 (1.0 to 4.0) does not hold: 50% arrived" in lines
    assert "copies on the link, relay_300k: 1 kB: 3.0" in lines
    assert "latency sealed / plain: 100 B: 1.0, 10 kB: 1.0" in lines
    assert "revocation_ms 109.0" in lines
    assert "mesh of 2: a 1" in lines


def test_statements_are_said_with_their_ratio() -> None:
    text = report.text(made())
    assert "by radio the variance of the latency is smaller: not measured" in text
    assert "5.2.5, relay" in text
    assert "5.2.5, gateway" not in text


def test_sizes_are_in_units_of_the_thesis() -> None:
    assert [report.size(each) for each in (0, 999, 5000, 1_500_000)] == ["0 B", "999 B", "5 kB", "1.5 MB"]


def test_a_result_of_one_experiment_has_no_other() -> None:
    assert report.text(combined({}, {"memory_mb": {}})) == ""

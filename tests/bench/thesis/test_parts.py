"""The small parts: messages, rates, memory, gaps, points, options."""

import asyncio
import json
from pathlib import Path

import pytest

from bench import __main__ as bench
from bench import thesis
from bench.thesis import latency, memory, meshes
from bench.thesis.failures import longest_gap
from bench.thesis.network import burst, shaped
from bench.thesis.node import Arrivals, send
from bench.thesis.table import SETUPS
from bench.thesis.talk import Point, message, stamp
from rossec.node import message_type

MEMORY = {"memory_mb": {"full": 60.0, "master": 29.0, "sidecar": 26.0, "relay": 35.0}}


def test_a_message_is_a_string_on_the_wire() -> None:
    data = message(7, 3, 5)
    assert stamp(data) == (7, 3)
    assert len(message_type("std_msgs/String").deserialize(data).data) == 16 + 5


async def test_messages_are_sent_on_time() -> None:
    sent = list[bytes]()
    begin = asyncio.get_running_loop().time()
    times = await send(sent.append, 1, Point(10, 100.0, 5))
    assert [stamp(each) for each in sent] == [(1, number) for number in range(5)]
    assert times == sorted(times)
    assert times[-1] - begin >= 0.04
    assert Point(10, 100.0, 5).seconds == 0.05


async def test_arrivals_are_of_one_point_and_the_first_time_counts() -> None:
    arrivals = Arrivals()
    for point, number in ((1, 0), (2, 0), (2, 1), (2, 1)):
        arrivals.add(message(point, number, 0))
    first = await arrivals.act({"number": 2})
    assert isinstance(first, dict)
    assert list(first) == [0, 1]
    assert await arrivals.act({"number": 2, "last": True}) == first
    assert await arrivals.act({"number": 2}) == {}


def test_a_link_lets_two_frames_through_at_once_or_a_millisecond() -> None:
    assert (burst(300), burst(100_000)) == (3200, 12_500)
    assert "eth0 root tbf rate 300kbit burst 3200 " in shaped("eth0", 300)


def test_memory_is_the_proportional_set_size() -> None:
    assert memory.pss("Rss:  9 kB\nPss:   1234 kB\nPss_Dirty:  5 kB\n") == 1234


def test_a_gap_is_the_longest_time_without_a_message() -> None:
    assert longest_gap({1: 5.0, 0: 1.0, 2: 5.5}) == 4
    assert longest_gap({}) == 0


@pytest.mark.parametrize("name", sorted(SETUPS))
def test_a_short_run_has_points_about_what_the_thesis_says(name: str) -> None:
    ladders = list(latency.short(name))
    assert {point.rate for point in ladders[-1]} == {1}
    assert sum(point.seconds for ladder in ladders for point in ladder) < 20


def test_a_whole_run_goes_through_sizes_and_rates() -> None:
    ladders = list(latency.whole("direct_100m"))
    assert [ladder[0].rate for ladder in ladders] == list(latency.RATES)
    assert [point.size for point in ladders[0]][:4] == [0, 100, 200, 500]
    assert latency.SIZES[-1] == 5_000_000
    assert all(point.seconds <= latency.LONGEST for ladder in ladders for point in ladder)


@pytest.mark.parametrize("name", sorted(SETUPS))
def test_a_sweep_has_a_few_minutes_of_points_for_each_set_up(name: str) -> None:
    ladders = list(latency.sweep(name))
    assert [ladder[0].rate for ladder in ladders] == [1, 10, 100]
    assert [point.size for point in ladders[1]][:4] == [0, 100, 1000, 10_000]
    assert sum(point.seconds for ladder in ladders for point in ladder) < 180


def test_masters_of_a_mesh_have_labels_of_their_own() -> None:
    assert list(meshes.labels(meshes.names(3)).values()) == ["master", "m1", "m2"]


def test_every_experiment_is_one_that_can_be_set_up() -> None:
    assert {name for each in thesis.EXPERIMENTS.values() for name in each} == set(SETUPS)


def test_the_command_line_takes_options_of_the_thesis_alone() -> None:
    options, given = bench.parse(["thesis", "5.1", "mesh", "--full", "--json"])
    assert (options.json, given["experiments"], given["full"]) == (True, ["5.1", "mesh"], True)
    with pytest.raises(SystemExit):
        bench.parse(["policy", "--full"])
    assert bench.parse(["policy"])[1] == {}


def test_a_saved_result_is_told_again(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    saved = tmp_path / "result"
    saved.write_text("== thesis\n" + json.dumps(MEMORY) + "\n")
    bench.main(["thesis", "--saved", str(saved)])
    assert "thesis: 54.5 (full)" in capsys.readouterr().out


def test_a_check_fails_for_a_statement_that_does_not_hold(tmp_path: Path) -> None:
    saved = tmp_path / "result"
    row = {"says": "it is larger", "ratio": 0.5, "bound": "> 1", "holds": False}
    saved.write_text(json.dumps({"statements": {"relay": {"larger": row}}}))
    with pytest.raises(SystemExit, match=r"relay larger: it is larger: 0\.5, not > 1"):
        thesis.measure(0, saved=saved, check=True)


def test_plots_have_a_file_for_each_figure(tmp_path: Path) -> None:
    pytest.importorskip("matplotlib", reason="NOT RUN: extra bench is not installed")
    saved = tmp_path / "result"
    row = {"size": 0, "rate": 1, "mean": 2.0, "low": 1.0, "high": 3.0, "holds": True}
    result = {**MEMORY, "latency_ms": {"relay_300k": [row]}, "largest_at_1hz": {"relay_300k": 5}}
    saved.write_text(json.dumps(result))
    thesis.measure(0, saved=saved, plot=tmp_path / "plots")
    found = {each.name: each.read_bytes()[:4] for each in (tmp_path / "plots").iterdir()}
    assert found == dict.fromkeys(("relay_300k.png", "largest.png", "memory.png"), b"\x89PNG")

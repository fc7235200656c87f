"""Every benchmark can be started: a broken import must not stay unnoticed."""

import importlib

import pytest

from bench import __main__ as bench


@pytest.mark.parametrize("name", bench.names())
def test_every_benchmark_measures(name: str) -> None:
    assert callable(importlib.import_module(f"bench.{name}").measure)


def test_a_result_is_a_table_for_people() -> None:
    text = bench.table({"a": 1, "b": {"c": 2.5}})
    assert text.splitlines() == [f"{'a':<32} 1", "b:", f"  {'c':<32} 2.5"]


def test_policy_is_measured_in_moments() -> None:
    result = importlib.import_module("bench.policy").measure(0.03)
    assert set(result["decisions_per_s"]) == {"10", "1000", "10000"}

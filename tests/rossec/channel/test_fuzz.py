"""Every decoder: its seeds, cut anywhere, with a tail; then atheris for a fixed count."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

from tests.fuzz.decoders import DECODERS, flights, rfc9529, run

_RUNS = 2000


def test_the_corpora_are_there() -> None:
    assert len(rfc9529()) > 150
    assert len(flights()) >= 6
    for name, (_, seeds) in DECODERS.items():
        assert len(seeds()) > 0, name


@pytest.mark.parametrize("name", DECODERS)
def test_seeds_cut_anywhere_and_with_a_tail(name: str) -> None:
    for seed in DECODERS[name][1]():
        run(name, seed)
        run(name, seed + b"\0")
        for cut in range(0, len(seed), max(1, len(seed) // 8)):
            run(name, seed[:cut])


@pytest.mark.parametrize("name", DECODERS)
def test_coverage_guided(name: str) -> None:
    pytest.importorskip("atheris", reason="no wheel of atheris for this Python")
    done = subprocess.run(
        [sys.executable, "-m", "tests.fuzz", name, str(_RUNS)],
        cwd=Path(__file__).parents[3],
        capture_output=True,
        text=True,
        timeout=100,
        check=False,
    )
    assert done.returncode == 0, done.stderr[-3000:]
    counted = re.search(r"Done (\d+) runs", done.stderr)
    assert counted is not None, done.stderr[-3000:]
    assert int(counted[1]) >= _RUNS  # it ends between two batches of mutations

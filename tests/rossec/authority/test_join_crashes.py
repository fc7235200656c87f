"""A join under kill -9 at every single write (see `tests.support.join_crashes`)."""

import json
import subprocess
import sys
from pathlib import Path

import pytest


@pytest.mark.timeout(300)  # more than a hundred processes
def test_no_crash_loses_or_doubles_a_join(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "tests.support.join_crashes", str(tmp_path)]
    done = subprocess.run(command, capture_output=True, check=False, text=True, timeout=280)
    assert done.returncode == 0, done.stderr
    deaths = json.loads(done.stdout)
    assert set(deaths) == {"join", "wait", "end", "invite"}
    for counted in deaths.values():
        assert counted["pwrite64"] >= 10
        assert counted["fdatasync"] >= 2

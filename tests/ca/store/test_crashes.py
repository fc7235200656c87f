"""The record under kill -9 at every single write (see `tests.support.crashes`)."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

SCENARIOS = {"issue", "deny", "collect", "revoke", "renew", "replace", "approve", "trust", "rename"}


@pytest.mark.timeout(300)  # some 310 processes: seconds on an idle machine, minutes on a busy one
def test_no_crash_loses_or_doubles_an_identity(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "tests.support.crashes", str(tmp_path)]
    done = subprocess.run(command, capture_output=True, check=False, text=True, timeout=280)
    assert done.returncode == 0, done.stderr
    deaths = json.loads(done.stdout)
    assert set(deaths) == SCENARIOS
    for counted in deaths.values():
        assert counted["pwrite64"] >= 10
        assert counted["fdatasync"] >= 4

"""Applying a policy under kill -9 at every single write (see `tests.support.apply_crashes`)."""

import json
import subprocess
import sys
from pathlib import Path

import pytest


@pytest.mark.timeout(300)  # some 60 processes: seconds on an idle machine
def test_no_crash_loses_or_doubles_a_grant(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "tests.support.apply_crashes", str(tmp_path)]
    done = subprocess.run(command, capture_output=True, check=False, text=True, timeout=280)
    assert done.returncode == 0, done.stderr
    deaths = json.loads(done.stdout)
    assert deaths["pwrite64"] >= 10
    assert deaths["fdatasync"] >= 2

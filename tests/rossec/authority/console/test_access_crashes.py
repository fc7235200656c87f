"""A phone that is added under kill -9 at every single write (see `tests.support.phone_crashes`)."""

import json
import subprocess
import sys
from pathlib import Path

import pytest


@pytest.mark.timeout(300)  # many processes
def test_no_crash_adds_half_a_phone(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "tests.support.phone_crashes", str(tmp_path)]
    done = subprocess.run(command, capture_output=True, check=False, text=True, timeout=280)
    assert done.returncode == 0, done.stderr
    deaths = json.loads(done.stdout)
    assert deaths["pwrite64"] >= 5
    assert deaths["fdatasync"] >= 1

"""Lists that are taken under kill -9 at every single write (see `tests.support.domain_crashes`)."""

import json
import subprocess
import sys
from pathlib import Path

import pytest


@pytest.mark.timeout(120)  # many processes
def test_lists_are_whole_after_a_kill_at_any_write(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "tests.support.domain_crashes", str(tmp_path)]
    done = subprocess.run(command, capture_output=True, check=False, text=True, timeout=100)
    assert done.returncode == 0, done.stderr
    deaths = json.loads(done.stdout)
    assert deaths["rename"] >= 2
    assert deaths["fsync"] >= 4

"""Approvals under kill -9 at every single write (see `tests.support.approval_crashes`)."""

import json
import subprocess
import sys
from pathlib import Path

import pytest


@pytest.mark.timeout(300)  # some hundred processes
@pytest.mark.parametrize(
    "kinds", [["enroll"], ["grant"], ["policy"], ["delegate"], ["invitation", "revoke-master"]], ids=" ".join
)
def test_no_crash_loses_or_doubles_what_was_approved(tmp_path: Path, kinds: list[str]) -> None:
    command = [sys.executable, "-m", "tests.support.approval_crashes", str(tmp_path), *kinds]
    done = subprocess.run(command, capture_output=True, check=False, text=True, timeout=280)
    assert done.returncode == 0, done.stderr
    deaths = json.loads(done.stdout)
    assert deaths.keys() >= set(kinds)
    assert min(deaths.values()) >= 20

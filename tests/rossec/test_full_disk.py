"""A really full disk: each command says so, nothing is called damaged, and nothing has changed.

"Restore it from a backup" was said before; whoever obeyed undid the revocations made since.
"""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

FULL = ("the disk is full, nothing was changed", "no space left on device")


def mounting() -> list[str]:
    """How to get a namespace in which one may mount; root needs no other user's."""
    return ["unshare", "--mount"] if os.geteuid() == 0 else ["unshare", "--map-root-user", "--mount"]


@pytest.mark.skipif(
    subprocess.run([*mounting(), "true"], check=False, capture_output=True).returncode != 0,
    reason="this host allows no mount namespaces; test_files and test_faults limit files instead",
)
@pytest.mark.timeout(180)
def test_a_full_disk_is_reported_and_changes_nothing(tmp_path: Path) -> None:
    command = [*mounting(), sys.executable, "-m", "tests.support.fulldisk", str(tmp_path / "home")]
    done = subprocess.run(command, capture_output=True, check=False, text=True, timeout=150)
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    assert found["changed"] == found["new"] == []
    for name, (code, said) in found["said"].items():
        assert code == 1, name
        assert any(text in said.lower() for text in FULL), (name, said)
        assert "make room" in said, (name, said)
        assert "damaged: restore" not in said
        assert "restore it from" not in said
    (verified, _), (revoked, said) = found["again"]
    assert verified == 0
    assert (revoked, "the list is signed and stored" in said) == (3, True)

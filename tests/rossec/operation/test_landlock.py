"""A process that may open few files: in one of its own, since it stays so."""

import ctypes
import subprocess
import sys
from pathlib import Path

import pytest

from rossec.operation import landlock

PROGRAM = """
import sys, threading
from pathlib import Path
from rossec.operation.landlock import read_only
allowed, denied = map(Path, sys.argv[1:])
opened = denied.open()
read_only([allowed, allowed / "missing"])
results = []

def look():
    assert (allowed / "file").read_text() == "yes"
    for attempt in (denied.read_text, lambda: (allowed / "new").write_text("x"), denied.unlink):
        try:
            attempt()
        except PermissionError:
            continue
        results.append(attempt)

look()
thread = threading.Thread(target=look)
thread.start()
thread.join()
assert opened.read() == "secret"
sys.exit(len(results))
"""


def test_it_reads_what_is_allowed_and_nothing_else(tmp_path: Path) -> None:
    (tmp_path / "allowed").mkdir()
    (tmp_path / "allowed" / "file").write_text("yes")
    (tmp_path / "secret").write_text("secret")
    arguments = [str(tmp_path / "allowed"), str(tmp_path / "secret")]
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM, *arguments], capture_output=True, text=True, check=False
    )
    if "Landlock: Function not implemented" in done.stderr or "not supported" in done.stderr:
        pytest.skip("NOT RUN: this kernel has no Landlock")
    assert (done.returncode, done.stderr) == (0, "")


def test_a_kernel_without_it_is_an_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    class Without:
        def syscall(self, *_: object) -> int:
            ctypes.set_errno(38)
            return -1

    monkeypatch.setattr(landlock, "_LIBC", Without())
    with pytest.raises(OSError, match="Landlock: Function not implemented"):
        landlock.read_only([tmp_path])

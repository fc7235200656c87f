"""A process with a key: in one of its own, since it stays so."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

PROGRAM = """
import ctypes, os, resource, subprocess, sys
from rossec.host.sandbox import is_protected, protect_memory
assert not is_protected()
protect_memory()
assert is_protected()
assert resource.getrlimit(resource.RLIMIT_CORE) == (0, 0)
print("ready", flush=True)
sys.stdin.read()
"""
PTRACE_SEIZE = 0x4206


def test_a_protected_process_is_not_read_by_its_user() -> None:
    other_user = 65534 if os.getuid() == 0 else None
    with subprocess.Popen(
        [sys.executable, "-c", PROGRAM], stdin=subprocess.PIPE, stdout=subprocess.PIPE, user=other_user
    ) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == b"ready\n"
        # Files of an undumpable process belong to root (proc(5)): its user may not open them.
        assert Path(f"/proc/{process.pid}/mem").stat().st_uid == 0
        process.communicate(b"")
    assert process.returncode == 0


def test_protection_is_for_the_whole_process() -> None:
    done = subprocess.run(  # also recorded for coverage: as another user it could write no file
        [sys.executable, "-c", PROGRAM], stdin=subprocess.DEVNULL, capture_output=True, check=False
    )
    assert (done.returncode, done.stdout, done.stderr) == (0, b"ready\n", b"")


def test_a_kernel_that_refuses_is_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    from rossec.host import sandbox as process_memory

    class Refusing:
        def prctl(self, *_: int) -> int:
            return -1

    monkeypatch.setattr(process_memory, "LIBC", Refusing())
    with pytest.raises(OSError, match="prctl 4"):
        process_memory.protect_memory()

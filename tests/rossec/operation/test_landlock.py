"""A process that may open few files: in one of its own, since it stays so."""

import ctypes
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from rossec.host import sandbox

# A confined process can write no file with what was measured in it.
UNMEASURED = {key: value for key, value in os.environ.items() if not key.startswith("COVERAGE")}
PROGRAM = """
import sys, threading
from pathlib import Path
from rossec.host.sandbox import read_only
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
        [sys.executable, "-c", PROGRAM, *arguments],
        capture_output=True,
        text=True,
        check=False,
        env=UNMEASURED,
    )
    if "Landlock: Function not implemented" in done.stderr or "not supported" in done.stderr:
        pytest.skip("NOT RUN: this kernel has no Landlock")
    assert (done.returncode, done.stderr) == (0, "")


class PlayedKernel:
    """Records the system calls; `prctl` is the result of that one."""

    def __init__(self, prctl: int = 0) -> None:
        self.ruleset = os.open(os.devnull, os.O_RDONLY)
        self.calls: list[tuple[int, ...]] = []
        self._prctl = prctl

    def syscall(self, number: int, *arguments: Any) -> int:
        if number == 444:
            self.calls.append((number, arguments[0]._obj.handled_access_fs))
            return self.ruleset
        if number == 445:
            self.calls.append((number, arguments[0], arguments[2]._obj.allowed_access))
        else:
            self.calls.append((number, arguments[0]))
        return 0

    def prctl(self, option: int, value: int, *_: int) -> int:
        self.calls.append((option, value))
        return self._prctl


def test_files_and_directories_are_allowed_for_reading_and_all_else_is_handled(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file, kernel = tmp_path / "file", PlayedKernel()
    file.touch()
    monkeypatch.setattr(sandbox, "LIBC", kernel)
    sandbox.read_only([tmp_path, file, tmp_path / "missing"])
    assert kernel.calls == [
        (444, 0x1FFF),
        (445, kernel.ruleset, 0b1100),
        (445, kernel.ruleset, 0b0100),
        (38, 1),  # no new privileges, without which the next call is refused
        (446, kernel.ruleset),
    ]
    with pytest.raises(OSError, match="Bad file descriptor"):
        os.fstat(kernel.ruleset)


def test_a_process_that_may_gain_privileges_is_not_confined(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    kernel = PlayedKernel(prctl=-1)
    monkeypatch.setattr(sandbox, "LIBC", kernel)
    with pytest.raises(OSError, match="prctl"):
        sandbox.read_only([tmp_path])
    assert kernel.calls[-1] == (38, 1)


def test_a_kernel_without_it_is_an_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    class Without:
        def syscall(self, *_: object) -> int:
            ctypes.set_errno(38)
            return -1

    monkeypatch.setattr(sandbox, "LIBC", Without())
    with pytest.raises(OSError, match="Landlock: Function not implemented"):
        sandbox.read_only([tmp_path])

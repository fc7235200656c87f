"""What a confined process cannot do: read the files of its user, start a process or a thread."""

import os
import resource
import subprocess
import sys
import threading
from pathlib import Path

import pytest

from rossec.host import sandbox
from rossec.host.confinement import confine_files, confine_processes

# A confined process can write no file, so it records no coverage.
UNMEASURED = {key: value for key, value in os.environ.items() if not key.startswith("COVERAGE")}

CONFINED = """
import os, sys, threading
from rossec.host.confinement import confine_processes
if os.getuid() == 0:
    os.setuid(65534)
executor = confine_processes()
assert executor.submit(lambda: 5).result() == 5
for start in (os.fork, threading.Thread(target=print).start):
    try:
        start()
    except (OSError, RuntimeError):
        continue
    sys.exit("a process or thread was started")
"""


def test_it_can_start_no_process() -> None:
    done = subprocess.run(
        [sys.executable, "-c", CONFINED], env=UNMEASURED, capture_output=True, text=True, check=False
    )
    assert (done.returncode, done.stderr) == (0, "")


def test_the_threads_of_its_executor_are_there_before_new_ones_are_forbidden(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    limits: list[tuple[object, int]] = []

    def forbid(*limit: object) -> None:
        limits.append((limit, threading.active_count() - before))

    before = threading.active_count()
    monkeypatch.setattr(resource, "setrlimit", forbid)
    with confine_processes() as executor:
        assert executor.submit(lambda: 5).result() == 5
    assert limits == [((resource.RLIMIT_NPROC, (0, 0)), 4)]


def test_a_kernel_that_cannot_confine_files_is_reported(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    def refuse(_: object) -> None:
        raise OSError("no Landlock")

    monkeypatch.setattr(sandbox, "read_only", refuse)
    confine_files([tmp_path])
    assert "can read the files of its user: no Landlock" in caplog.text


FILES = """
import sys
from pathlib import Path
from rossec.host.confinement import confine_files
own = Path(sys.argv[1])
confine_files([own])
assert (own / "node.key").read_bytes()
for secret in ("ca.key", "ca.db", "passphrase"):
    try:
        (own.parent / secret).read_bytes()
    except PermissionError:
        continue
    sys.exit("it reads " + secret)
"""


def test_it_reads_no_file_beside_its_own(tmp_path: Path) -> None:
    (tmp_path / "own").mkdir()
    for name in ("own/node.key", "ca.key", "ca.db", "passphrase"):
        (tmp_path / name).write_text("something")
    done = subprocess.run(
        [sys.executable, "-c", FILES, str(tmp_path / "own")],
        env=UNMEASURED,
        capture_output=True,
        text=True,
        check=False,
    )
    if "can read the files of its user" in done.stderr:
        pytest.skip("NOT RUN: this kernel has no Landlock")
    assert (done.returncode, done.stderr) == (0, "")

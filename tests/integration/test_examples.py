"""Every file in examples/ runs, in the order of its number, and does what its docstring says."""

import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

EXAMPLES = Path(__file__).parents[2] / "examples"
SCRIPTS = Path(sys.executable).parent


@pytest.fixture(scope="module")
def environ(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    path = f"{SCRIPTS}:{os.environ['PATH']}"
    home = str(tmp_path_factory.mktemp("examples") / "home")
    return {**os.environ, "PATH": path, "ROSSEC_HOME": home, "ROS_IP": "127.0.0.1"}


def run(name: str, environ: dict[str, str]) -> subprocess.CompletedProcess[str]:
    program = [sys.executable] if name.endswith(".py") else []
    return subprocess.run(
        [*program, str(EXAMPLES / name)],
        env=environ,
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )


@pytest.fixture(scope="module")
def enrolled(environ: dict[str, str]) -> Iterator[dict[str, str]]:
    done = run("0_enroll.sh", environ)
    assert done.returncode == 0, done.stderr
    master = subprocess.Popen(
        [SCRIPTS / "rossec", "master", "--port", "0"], env=environ, stdout=subprocess.PIPE, text=True
    )
    assert master.stdout is not None
    environ["ROS_MASTER_URI"] = master.stdout.readline().split()[-1]
    yield environ
    master.send_signal(signal.SIGTERM)
    assert master.wait(30) == 0
    master.stdout.close()


def test_every_example_is_short_and_run_here() -> None:
    files = sorted(path.name for path in EXAMPLES.iterdir() if path.suffix in {".py", ".sh"})
    source = Path(__file__).read_text()
    assert "begin.sh" in (EXAMPLES / "0_enroll.sh").read_text()
    files.remove("begin.sh")  # which that runs
    assert len(files) >= 5
    for name in files:
        assert f'"{name}"' in source, f"{name} is not run by a test"
        assert len((EXAMPLES / name).read_text().splitlines()) <= 60


def test_the_listener_receives_the_talker(enrolled: dict[str, str]) -> None:
    talker = subprocess.Popen([sys.executable, EXAMPLES / "1_talker.py"], env=enrolled)
    try:
        heard = run("2_listener.py", enrolled)
    finally:
        talker.terminate()
        talker.wait(30)
    assert heard.returncode == 0, heard.stderr
    lines = heard.stdout.splitlines()
    assert len(lines) == 3
    first = int(lines[0].split()[1])
    assert lines == [f"hello {number}" for number in range(first, first + 3)]


def test_the_viewer_gets_the_room_but_not_the_position(enrolled: dict[str, str]) -> None:
    done = run("3_room_not_position.sh", enrolled)
    assert done.returncode == 0, done.stderr
    assert "    x: 4.0\n    y: 0.0\n" in done.stdout
    assert "frame_id: ''\n" in done.stdout


def test_a_service_and_a_parameter_are_used(enrolled: dict[str, str]) -> None:
    done = run("4_service.py", enrolled)
    assert done.returncode == 0, done.stderr
    assert done.stdout == "quiet\nthe rate is now 5\n"


def test_a_revoked_grant_ends_the_example(enrolled: dict[str, str]) -> None:
    done = run("5_revoke.sh", enrolled)
    assert done.returncode == 0, done.stderr
    assert done.stdout.count("the master has the new list") == 2
    assert all(line.endswith("revoked") for line in done.stdout.splitlines()[-2:])
    refused = run("2_listener.py", enrolled)
    assert refused.returncode == 1
    assert "subscribe" in refused.stderr
    assert "Traceback" not in refused.stderr

"""Every program in examples/rospy runs; so does the guide for the first node."""

import os
import re
import shlex
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Final

import pytest

pytestmark = pytest.mark.ros

ROOT: Final = Path(__file__).parents[2]
EXAMPLES: Final = ROOT / "examples" / "rospy"
GUIDE: Final = ROOT / "docs" / "howto" / "first-rospy-node.md"
SCRIPTS: Final = Path(sys.executable).parent


def environment(directory: Path) -> dict[str, str]:
    kept = {key: value for key, value in os.environ.items() if not key.startswith("ROS")}
    return {
        **kept,
        "PATH": f"{SCRIPTS}:{os.environ['PATH']}",
        "ROS_IP": "127.0.0.1",
        "ROSSEC_HOME": str(directory / "home"),
        "PYTHONPATH": str(ROOT),
        "PYTHONUNBUFFERED": "1",
        "ROS_HOME": str(directory),
        "ROS_LOG_DIR": str(directory / "logs"),
    }


@contextmanager
def running(env: dict[str, str], *command: str | Path) -> Iterator[subprocess.Popen[str]]:
    process = subprocess.Popen(command, env=env, stdout=subprocess.PIPE, text=True)
    try:
        yield process
    finally:
        process.send_signal(signal.SIGTERM)
        process.communicate(timeout=20)


def run(env: dict[str, str], *command: str | Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        command,
        env=env,
        capture_output=True,
        text=True,
        timeout=90,
        check=False,
        stdin=subprocess.DEVNULL,
        cwd=ROOT,
    )


@pytest.fixture(scope="module")
def five_minutes(tmp_path_factory: pytest.TempPathFactory) -> Iterator[subprocess.Popen[str]]:
    """The guide's commands, run in parallel to the examples: they share nothing."""
    directory = tmp_path_factory.mktemp("guide")
    with subprocess.Popen(
        ["bash", "-c", script(directory)],
        env=environment(directory),
        cwd=ROOT,
        text=True,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
    ) as process:
        yield process
        process.kill()


@pytest.fixture(scope="module")
def site(
    tmp_path_factory: pytest.TempPathFactory,
    five_minutes: subprocess.Popen[str],  # started before the first example
) -> Iterator[dict[str, str]]:
    env = environment(tmp_path_factory.mktemp("rospy"))
    done = run(env, EXAMPLES / "enroll.sh")
    assert done.returncode == 0, done.stderr
    with running(env, SCRIPTS / "rossec", "master", "--port", "0") as master:
        assert master.stdout is not None
        env["ROS_MASTER_URI"] = master.stdout.readline().split()[-1]
        yield env


def example(env: dict[str, str], name: str) -> list[str]:
    done = run(env, sys.executable, EXAMPLES / name)
    assert done.returncode == 0, done.stderr
    return done.stdout.splitlines()


def test_every_example_is_short_and_run_here() -> None:
    files = sorted(path.name for path in EXAMPLES.iterdir() if path.suffix in {".py", ".sh"})
    source = Path(__file__).read_text()
    assert len(files) == 8
    for name in files:
        assert f'"{name}"' in source, f"{name} is not run by a test"
        assert len((EXAMPLES / name).read_text().splitlines()) <= 60


def test_a_publisher_and_a_subscriber_exchange_messages(site: dict[str, str]) -> None:
    with running(site, sys.executable, EXAMPLES / "1_publisher.py"):
        lines = example(site, "2_subscriber.py")
    assert len(lines) == 3
    assert all(re.fullmatch(r"hello \d+", line) for line in lines)


def test_a_service_is_called(site: dict[str, str]) -> None:
    with running(site, sys.executable, EXAMPLES / "3_service.py"):
        assert example(site, "4_client.py") == ["on off"]


def test_parameters_are_set_and_read(site: dict[str, str]) -> None:
    done = run(site, sys.executable, EXAMPLES / "5_parameters.py")
    said = done.stdout + done.stderr
    assert "speed 0.5\n" in said
    assert "secret not for us\n" in said
    assert "rossec: /viewer may not param-get " in said


def test_the_viewer_does_not_see_where_the_camera_is(site: dict[str, str]) -> None:
    with running(site, sys.executable, EXAMPLES / "6_camera.py"):
        assert example(site, "7_viewer.py") == ["640 x 480 ''"] * 3


def commands() -> list[str]:
    """The guide's commands: its code blocks without a language."""
    blocks = re.findall(r"^```(\w*)\n(.*?)^```$", GUIDE.read_text(), re.MULTILINE | re.DOTALL)
    return [line for language, block in blocks if not language for line in block.splitlines()]


def script(directory: Path) -> str:
    """The guide's commands as one script, in directories of this test."""
    passphrase = f"{directory}/passphrase"
    lines = ["set -e", "trap 'kill $(jobs -p)' EXIT", f"cd {shlex.quote(str(ROOT))}"]
    for line in commands():
        typed = re.sub(r"(file|>) passphrase", rf"\1 {passphrase}", line)
        typed = typed.replace("~/rossec-first", str(directory / "home"))
        if typed == "rossec master &":
            typed = (
                f"rossec master --port 0 > {directory}/master &\n"
                f"until [ -s {directory}/master ]; do sleep 0.1; done\n"
                f"export ROS_MASTER_URI=$(grep -o 'http[^ ]*' {directory}/master)"
            )
        lines.append(typed)
    return "\n".join(lines)


def test_the_five_minute_example_runs(five_minutes: subprocess.Popen[str]) -> None:
    said, _ = five_minutes.communicate(timeout=120)
    assert five_minutes.returncode == 0, said
    assert len(re.findall(r"^hello \d+$", said, re.MULTILINE)) == 3
    assert said.count("ok      ") >= 3
    assert "not ok" not in said

"""`rossec console --demo` as a user starts it: real processes, and nothing left afterwards."""

import http.client
import os
import re
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import urlencode, urlsplit

import pytest

from tests.support.ports import free_port

ROSSEC = str(Path(sys.executable).parent / "rossec")
CODE = re.compile(r"^ROSSEC:.*\S")
LINK = re.compile(r"http://localhost:\d+/login#\S+")


@dataclass
class Demo:
    """A demo that runs: where its files are, and the link it printed."""

    process: subprocess.Popen[str]
    directory: Path
    link: str
    code: str = ""

    def ask(self, path: str, form: dict[str, str] | None = None, cookie: str = "") -> tuple[int, str, str]:
        """Status, cookie and page, as a browser at the link gets them."""
        parts = urlsplit(self.link)
        connection = http.client.HTTPConnection("127.0.0.1", parts.port, timeout=30)
        headers = {"Host": parts.netloc, "Origin": f"http://{parts.netloc}"}
        if cookie:
            headers["Cookie"] = cookie
        if form is not None:
            headers["Content-Type"] = "application/x-www-form-urlencoded"
        connection.request("GET" if form is None else "POST", path, urlencode(form or {}) or None, headers)
        answer = connection.getresponse()
        body = answer.read().decode()
        connection.close()
        found = (answer.headers.get("Set-Cookie") or "").partition(";")[0]
        return answer.status, found, body

    def log_in(self) -> str:
        status, cookie, _ = self.ask("/login", {"code": urlsplit(self.link).fragment})
        assert status == 303
        return cookie

    def stop(self, number: int) -> int:
        self.process.send_signal(number)
        return self.process.wait(30)


def processes_in(directory: Path) -> list[str]:
    """Command lines of processes whose home is in `directory`."""
    found = []
    for path in Path("/proc").glob("[0-9]*"):
        try:
            environ = (path / "environ").read_bytes()
            if str(directory).encode() in environ:
                found.append((path / "cmdline").read_bytes().replace(b"\0", b" ").decode())
        except OSError:
            continue
    return found


@pytest.fixture
def demo() -> Iterator[Demo]:
    with tempfile.TemporaryDirectory() as directory:  # a short path, for sockets
        yield from started(Path(directory))


def started(directory: Path) -> Iterator[Demo]:
    environ = {key: text for key, text in os.environ.items() if not key.startswith("ROS")}
    process = subprocess.Popen(
        [ROSSEC, "console", "--demo", "--port", str(free_port())],
        env={**environ, "TMPDIR": str(directory)},
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )
    try:
        yield Demo(process, directory, read(process, LINK), read(process, CODE))
    finally:
        if process.poll() is None:
            process.send_signal(signal.SIGINT)
            process.wait(60)
        if process.stdout is not None:
            process.stdout.close()


def read(process: subprocess.Popen[str], wanted: re.Pattern[str]) -> str:
    said = []
    assert process.stdout is not None
    for line in process.stdout:
        said.append(line)
        if found := wanted.search(line):
            return found[0]
    raise AssertionError("".join(said))


def test_the_demo_shows_its_story_and_leaves_nothing(demo: Demo) -> None:
    cookie = demo.log_in()
    status, _, page = demo.ask("/", cookie=cookie)
    assert status == 200
    for name in ("/robot", "/doctor", "/heating", "/lamp"):
        assert name in page
    assert "One thing waits for you" in page
    assert "to light the room that the robot is in" in page
    assert "Dr. Meier" in page
    question = re.search(r'href="(/ask/[^"]+)"', page)
    assert question is not None
    assert "Only roughly where it is" in demo.ask(question[1], cookie=cookie)[2]
    link = re.search(r'href="(/see/[^"]*pose)"', page)
    assert link is not None
    status, _, page = demo.ask(link[1], cookie=cookie)
    assert status == 200
    assert "<svg" in page
    assert demo.ask("/login", {"code": urlsplit(demo.link).fragment})[0] != 303  # once
    status, _, _ = demo.ask("/add", {"code": demo.code}, cookie=cookie)
    assert status == 303, "a code to scan"
    assert processes_in(demo.directory)
    assert demo.stop(signal.SIGINT) == 0
    end = time.monotonic() + 10
    while processes_in(demo.directory) and time.monotonic() < end:
        time.sleep(0.1)
    assert processes_in(demo.directory) == []
    assert list(demo.directory.glob("rossec-demo-*")) == []


def test_a_part_that_ends_ends_the_demo_and_says_which(demo: Demo) -> None:
    robot = next(int(path.name) for path in Path("/proc").glob("[0-9]*") if is_robot_of(path, demo.directory))
    os.kill(robot, signal.SIGKILL)
    assert demo.process.wait(30) == 1
    assert demo.process.stdout is not None
    assert "rossec: error: robot has ended" in demo.process.stdout.read()
    assert list(demo.directory.glob("rossec-demo-*")) == []


def is_robot_of(process: Path, directory: Path) -> bool:
    try:
        command, environ = (process / "cmdline").read_bytes(), (process / "environ").read_bytes()
    except OSError:
        return False
    return b"rossec.demo.robot" in command and str(directory).encode() in environ


def test_the_demo_is_for_localhost(tmp_path: Path) -> None:
    done = subprocess.run(
        [ROSSEC, "console", "--demo", "--lan"],
        env={**os.environ, "TMPDIR": tempfile.mkdtemp(dir=tmp_path)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 1
    assert "--demo is for localhost" in done.stderr

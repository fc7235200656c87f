"""`rossec demo` as a user starts it: its claims hold, and loopback shows no plaintext."""

import base64
import contextlib
import os
import re
import secrets
import shlex
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import pytest

from rossec.channel.opening import WireProtocol, first_bytes
from rossec.demo.robot import CAMERA, FRAME, POSE, SCAN
from rossec.node import message_type
from tests.support.ports import free_port
from tests.support.recorder import Recording, record

BIN: Final = Path(sys.executable).parent
ROSSEC: Final = str(BIN / "rossec")
MARKER: Final = secrets.token_hex(24).encode()
LIMIT: Final = 30.0  # seconds: stated in the README
SLICE: Final = 24
API_WORDS: Final = (
    b"methodCall",
    b"methodResponse",
    b"methodName",
    b"registerPublisher",
    b"registerSubscriber",
    b"requestTopic",
    b"publisherUpdate",
    b"callerid",
    b"md5sum",
    b"message_definition",
    b"tcp_nodelay",
    b"latching",
    b"TCPROS",
    b"rossec_grants",
    b"rossec.presentGrants",
    b"rossec.revocations",
    b"rossec-grant",
    b"rossec-revocation",
)


@dataclass(frozen=True)
class Played:
    """One demo, recorded."""

    directory: Path
    code: int
    said: str
    errors: str
    seconds: float
    recording: Recording


def environment(**more: str) -> dict[str, str]:
    kept = {key: value for key, value in os.environ.items() if not key.startswith("ROS")}
    return {**kept, **more}


@pytest.fixture(scope="module")
def played(tmp_path_factory: pytest.TempPathFactory) -> Played:
    """The demo runs once for all these tests."""
    path = tmp_path_factory.mktemp("demo")
    begin = time.monotonic()
    recording, done = record(
        path / "packets", MARKER, [ROSSEC, "demo", "--keep", str(path / "kept")], environment()
    )
    seconds = time.monotonic() - begin
    return Played(path / "kept", done.returncode, done.stdout, done.stderr, seconds, recording)


def test_the_demo_succeeds_with_its_claims(played: Played) -> None:
    assert played.code == 0, played.said + played.errors
    assert played.errors == ""
    assert played.seconds < LIMIT
    assert played.said.count("done in") == 7
    figure = re.search(r"last image (-?\d+) ms after the command was given", played.said)
    assert figure is not None
    assert int(figure[1]) < 10_000  # it ended itself: the image's grant is valid for days


def test_the_recording_is_complete(played: Played) -> None:
    """The controls: without them an empty result would prove nothing."""
    recording = played.recording
    assert recording.dropped == 0
    assert recording.holds(MARKER)
    assert not any(MARKER in packet for packet in recording.packets), "flows are not joined"
    for port in map(int, re.findall(r"http://127\.0\.0\.1:(\d+)/", played.said)):
        there = [data for flow, data in recording.flows.items() if flow[3] == port]
        assert sum(map(len, there)) > 2000, f"nothing recorded of port {port}"
    images = [len(data) for flow, data in recording.flows.items()]
    assert max(images) > 10 * 320 * 240, "the camera was not recorded"


def test_every_connection_is_a_secured_one(played: Played) -> None:
    flows = played.recording.flows
    openings = tuple(map(first_bytes, WireProtocol))
    callers = [flow for flow, data in flows.items() if data.startswith(openings)]
    assert len(callers) > 10
    answers = {flow[2:] + flow[:2] for flow in callers}
    others = [data for flow, data in flows.items() if flow not in {*callers, *answers}]
    assert others == [MARKER, MARKER]


def names() -> Iterator[bytes]:
    """Words that would reveal the contents to an eavesdropper."""
    yield from (b"/robot", b"/doctor", b"/heating", b"/master", b"robot/", b"spiffe")
    for topic, type_name in (POSE, SCAN, CAMERA):
        package, leaf = type_name.encode().split(b"/")
        kind = message_type(type_name)
        yield from (topic.encode(), topic[1:].encode(), type_name.encode(), package, leaf)
        yield from (kind.md5sum.encode(), bytes.fromhex(kind.md5sum))
        yield from (line.encode() for line in kind.definition.splitlines() if len(line) > 12)
    yield from API_WORDS


def content() -> Iterator[bytes]:
    """Fields of the messages: the frame, the camera's grey ramp, its encoding with its length."""
    yield FRAME.encode()
    yield bytes(range(10, 80))
    yield bytes(range(180, 250))
    yield b"\x05\0\0\0mono8"


def test_no_name_and_no_content_went_over_the_network(played: Played) -> None:
    found = [secret for secret in (*names(), *content()) if played.recording.holds(secret)]
    assert found == []


def test_no_grant_list_or_certificate_went_over_the_network(played: Played) -> None:
    files = [
        *played.directory.rglob("*.grant"),
        *played.directory.rglob("revocations.cose"),
        *played.directory.rglob("node.pem"),
    ]
    assert len(files) >= 4 + 3 + 5
    everything = b"\0".join([*played.recording.packets, *played.recording.flows.values()])
    for file in files:
        for part in slices(file):
            assert part not in everything, f"a part of {file} went over the network in clear"


def slices(file: Path) -> set[bytes]:
    """Parts of a file that would be seen, raw or in base64 (as XML-RPC has it) at any alignment."""
    data = file.read_bytes()
    if file.suffix == ".pem":
        blocks = re.findall(rb"-----BEGIN[^-]+-----([^-]+)-----END", data)
        forms = [base64.b64decode(block) for block in blocks]
    else:
        forms = [data]
    forms += [base64.b64encode(form[shift:]) for form in tuple(forms) for shift in range(3)]
    return {form[at : at + SLICE] for form in forms for at in range(0, len(form) - SLICE + 1, SLICE)}


# --- using the kept home


def test_the_kept_home_of_the_demo_works(played: Played) -> None:
    """The commands as printed, in a shell without the venv."""
    lines = [line.strip() for line in played.said.splitlines()]
    export = next(line for line in lines if line.startswith("export "))
    master, robot, echo = lines[lines.index("rossec master") :][:3]
    env = environment(ROS_MASTER_URI=f"http://127.0.0.1:{free_port()}/")
    with running(f"{export}; exec {master}", env) as serving:
        assert serving.stdout is not None
        assert serving.stdout.readline().startswith("master of home at ")
        with running(f"{export}; exec {robot}", env) as driving:
            assert driving.stdout is not None
            assert "ready" in driving.stdout.readline()
            heard = shell(f"{export}; {echo} -n 2", env)
            assert heard.returncode == 0, heard.stderr
            assert heard.stdout.count("---") == 2
            assert "frame_id: ''\n" in heard.stdout
            assert FRAME not in heard.stdout
    for line in (line for line in lines if line.startswith("rossec grant ")):
        done = shell(f"{export}; {line}", env)
        assert done.returncode == 0, done.stderr
        assert "/heating" in done.stdout


def shell(line: str, env: dict[str, str]) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        ["/bin/bash", "-c", line], env=env, text=True, capture_output=True, timeout=30, check=False
    )


@contextlib.contextmanager
def running(line: str, env: dict[str, str]) -> Iterator[subprocess.Popen[str]]:
    process = subprocess.Popen(["/bin/bash", "-c", line], env=env, text=True, stdout=subprocess.PIPE)
    try:
        with process:
            yield process
            process.terminate()
    finally:
        process.kill()


# --- failing


def test_a_directory_that_exists_is_not_touched(tmp_path: Path) -> None:
    (tmp_path / "mine").write_text("precious")
    done = subprocess.run(
        [ROSSEC, "demo", "--keep", str(tmp_path)],
        env=environment(),
        text=True,
        capture_output=True,
        timeout=30,
        check=False,
    )
    assert done.returncode == 1
    assert done.stderr == (
        f"rossec: error: {tmp_path} exists\nrossec: hint: give a directory that does not exist\n"
    )
    assert [path.name for path in tmp_path.iterdir()] == ["mine"]


def test_a_step_that_fails_ends_the_demo_with_its_reason(tmp_path: Path) -> None:
    """The doctor is killed between two steps: the demo must not continue."""
    with subprocess.Popen(
        [ROSSEC, "demo", "--keep", str(tmp_path / "kept")],
        env=environment(PYTHONUNBUFFERED="1"),
        text=True,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
    ) as demo:
        assert demo.stdout is not None
        for line in demo.stdout:
            if " another authority " in line:
                os.kill(child_of(demo.pid, "rossec.demo.subscriber", "/doctor"), signal.SIGKILL)
        _, errors = demo.communicate(timeout=30)
        assert demo.returncode == 1
        assert errors.startswith("rossec: error: doctor: an image did not happen")
        assert "Traceback" not in errors


def test_a_disk_without_space_is_reported(tmp_path: Path) -> None:
    line = f"ulimit -f 0; exec {shlex.quote(ROSSEC)} demo --keep {shlex.quote(str(tmp_path / 'k'))}"
    done = shell(line, environment())
    assert done.returncode == 1
    assert done.stderr.startswith("rossec: error: ")
    assert "Traceback" not in done.stderr


def child_of(parent: int, *words: str) -> int:
    """The process that `parent` started with `words` on its command line."""
    for entry in Path("/proc").glob("[0-9]*"):
        with contextlib.suppress(OSError):
            command = (entry / "cmdline").read_text().split("\0")
            mine = f"\nPPid:\t{parent}\n" in (entry / "status").read_text()
            if mine and set(words) <= set(command):
                return int(entry.name)
    raise AssertionError(f"no {words} among the children of {parent}")

"""Small files that are costly to parse: each is given to the command that reads it.

What a bomb costs is bounded here by the kernel, in seconds of the processor and bytes of memory,
not by a clock: a loaded machine is slow, not wrong.
"""

import asyncio
import io
import os
import resource
import socket
import subprocess
import sys
from pathlib import Path

import pytest
from PIL import Image

from ca.enrollment import qr
from rossec.console.scanning import MAX_PICTURE
from rossec.console.server import supervisor as scanning
from rossec.console.server.supervisor import ScannerSupervisor
from rossec.console.server.web import ScannerClient
from rossec.errors import ConfigurationError, RossecError
from rossec.inprocess.options import read
from tests.support.commands import PASSPHRASE
from tests.support.site import Site

PROCESSOR = 30  # seconds; the worst of them took more than 40, and one did not end
MEMORY = 1200 * 1024 * 1024

pytestmark = [pytest.mark.attack("bombs"), pytest.mark.timeout(600)]


def limited() -> None:
    resource.setrlimit(resource.RLIMIT_CPU, (PROCESSOR, PROCESSOR))
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))


def refused(home: Path, *words: str, code: int = 1) -> str:
    """Run a command that must fail, with an error of ours, within limits; returns the output."""
    done = subprocess.run(
        (sys.executable, "-m", "rossec", *words),
        env={**os.environ, "ROSSEC_HOME": str(home), "ROS_IP": "127.0.0.1"},
        capture_output=True,
        text=True,
        check=False,
        timeout=500,
        preexec_fn=limited,
    )
    assert "Traceback" not in done.stderr
    assert done.returncode == code, (done.returncode, done.stderr[-500:])
    assert done.stderr.startswith("rossec: error: ")
    return done.stderr


def laughs(levels: int = 9, width: int = 9) -> str:
    """The "billion laughs": each list holds the one before nine times."""
    text = "&a0 [0]"
    for level in range(1, levels + 1):
        text = f"&a{level} [{text}{f', *a{level - 1}' * (width - 1)}]"
    return f"{{data: {text}}}"


CONFIGURATIONS = {
    "a merge of an alias": "base: &b {port: 1}\n<<: *b",
    "a merge of a list": "<<: [1, 2]",
    "a merge of itself": "a: &a {<<: *a}",
    "a merge of a map": "<<: {port: 1}",
    "a tag of a class": "port: !!python/object/apply:os.system [id]",
    "a tag of a set": "limits: !!set {body}",
    "an ordered map": "limits: !!omap [body: 1]",
    "a tag for a number": "port: !!int x",
    "a tag for a time": "port: !!timestamp x",
    "a tag for bytes": "port: !!binary x",
    "a huge integer": f"port: {'9' * 5000}",
    "a huge integer as a limit": f"limits: {{body: {'9' * 5000}}}",
    "a huge hexadecimal": f"port: 0x{'f' * 60000}",
    "a huge sexagesimal": "port: " + "59:" * 4000 + "59",
    "a bad date": "port: 2026-13-45",
    "a bad time": "port: 2026-02-30 25:61:61",
    "a date as a key": "2026-13-45: 1",
    "a list as a key": "? [1, 2]\n: 1",
    "a map as a key": "? {a: 1}\n: 1",
    "an alias bomb": laughs(),
    "5,000 brackets": "port: " + "[" * 5000,
    "5,000 braces": "port: " + "{" * 5000,
    "5,000 lists in lists": "- " * 5000,
    "5,000 brackets on 5,000 lines": "port: " + "[\n" * 5000,
    "a directive": "%YAML 1.1\n---\nport: 1",
    "two documents": "port: 1\n---\nport: 2",
    "an escape of nothing": 'denial_log: "a\\0b"',
    "a bare carriage return in a key": '"a\\rb": 1',
    "an alias of nothing": "port: *nowhere",
}


@pytest.mark.parametrize("text", CONFIGURATIONS.values(), ids=CONFIGURATIONS)
def test_a_masters_configuration(tmp_path: Path, text: str) -> None:
    (tmp_path / "master.yaml").write_text(text)
    said = refused(tmp_path, "master", "--config", str(tmp_path / "master.yaml"))
    assert f"{tmp_path}/master.yaml:" in said
    assert len(said) < 2000


MESSAGES = {
    "an alias bomb": laughs(),
    "an alias of itself": "{data: &a [*a]}",
    "brackets": "{data: " + "[" * 5000 + "}",
    "a class": "{data: !!python/object/apply:os.system [id]}",
    "a huge integer": "{data: " + "9" * 5000 + "}",
    "a bad date": "{data: 2026-02-30 25:61:61}{",
    "a merge": "{<<: *a, data: x}",
}


@pytest.mark.parametrize("text", MESSAGES.values(), ids=MESSAGES)
def test_a_message_to_publish(tmp_path: Path, text: str) -> None:
    refused(tmp_path, "topic", "pub", "/chatter", "std_msgs/Int32MultiArray", text, "--as", "/talker")


@pytest.mark.parametrize("text", MESSAGES.values(), ids=MESSAGES)
def test_a_message_in_a_file(tmp_path: Path, text: str) -> None:
    message = tmp_path / "message.yaml"
    message.write_text(text)
    (tmp_path / "policy.yaml").write_text("rossec: 1\nrules: []\ntypes: {/chatter: std_msgs/Int32MultiArray}")
    refused(
        tmp_path,
        "explain",
        "/talker",
        "publish",
        "/chatter",
        "--policy",
        str(tmp_path / "policy.yaml"),
        "--message",
        str(message),
    )


POLICIES = {
    "2 million words": "rules: [" + "a," * 2_000_000 + "]",
    "2 million lines": "rules:\n" + "- a\n" * 1_000_000,
    "5,000 brackets": "rules: " + "[" * 5000,
    "an alias bomb": laughs(),
    "100,000 types that do not exist": "rossec: 1\ntypes:\n"
    + "".join(f" /t{number}: std_msgs/Strng{number}\n" for number in range(100_000)),
    "100,000 wrong rules": "rossec: 1\nrules:\n" + "- {idd: 1}\n" * 100_000,
}


@pytest.mark.parametrize("text", POLICIES.values(), ids=POLICIES)
def test_a_policy(tmp_path: Path, text: str) -> None:
    (tmp_path / "policy.yaml").write_text(text)
    refused(tmp_path, "policy", "check", str(tmp_path / "policy.yaml"))


PROFILE = '<profile ns="/" node="n"><topics publish="ALLOW"><topic>x</topic></topics></profile>'
XML = {
    "a million elements": "<policy>" + "<a/>" * 1_000_000 + "</policy>",
    "300,000 levels": "<policy>" + "<a>" * 300_000 + "</a>" * 300_000 + "</policy>",
    "40,000 profiles of one node": f"<policy>{PROFILE * 40_000}</policy>",
    "150,000 topics of one node": '<policy><profile ns="/" node="n"><topics publish="ALLOW">'
    + "".join(f"<topic>t{number}</topic>" for number in range(150_000))
    + "</topics></profile></policy>",
    "entities": '<!DOCTYPE p [<!ENTITY a "aaaa"><!ENTITY b "&a;&a;">]><policy>&b;</policy>',
}


@pytest.mark.parametrize("text", XML.values(), ids=XML)
def test_a_policy_of_sros2(tmp_path: Path, text: str) -> None:
    (tmp_path / "policy.xml").write_text(text)
    refused(tmp_path, "policy", "import-sros2", str(tmp_path / "policy.xml"))


TOML = {
    "30,000 dots": ".".join(["a"] * 30_000) + " = 1",
    "5,000 brackets": "a = " + "[" * 5000,
    "5,000 braces": "a = " + "{a=" * 5000,
    "a huge integer": "a = " + "9" * 5000,
    "a bad date": "a = 2026-13-45",
}


@pytest.mark.parametrize("text", TOML.values(), ids=TOML)
def test_the_options_of_a_rospy_program(text: str) -> None:
    with pytest.raises(ConfigurationError):
        read({"ROSSEC_HOME": "/h"}, text)


def finder_patterns(across: int) -> bytes:
    """A picture of nothing but the corners of codes: every three of them may be a code."""
    white = [[max(abs(x - 3), abs(y - 3)) in {2, 4, 5} for x in range(9)] for y in range(9)]
    row = b"".join(bytes(line) * across for line in white)
    side = 9 * across
    image = Image.frombytes("L", (side, side), bytes(255 * value for value in row) * across)
    out = io.BytesIO()
    image.convert("1").save(out, "PNG")
    return out.getvalue()


def test_a_picture_of_finder_patterns(tmp_path: Path) -> None:
    home = Site(tmp_path / "site").root
    secret = tmp_path / "passphrase"
    secret.write_text(PASSPHRASE)
    secret.chmod(0o600)
    subprocess.run(
        (sys.executable, "-m", "rossec", "ca", "init", "home", "--passphrase-file", str(secret)),
        env={**os.environ, "ROSSEC_HOME": str(home)},
        check=True,
        capture_output=True,
    )
    picture = tmp_path / "photo.png"
    picture.write_bytes(finder_patterns(420))
    assert picture.stat().st_size < 40_000
    said = refused(home, "ca", "enroll", "--image", str(picture), "--passphrase-file", str(secret))
    assert "reading the picture took too long, or failed" in said
    assert "paste the text" in said


async def test_a_frame_of_finder_patterns_costs_the_console_one_worker(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The next frame is read by the next process."""
    monkeypatch.setattr(scanning, "START", 2.0)
    ours, theirs = socket.socketpair()
    client, text = ScannerClient(theirs), qr.label_code(b"a request")
    bomb = finder_patterns(420)
    assert len(bomb) < MAX_PICTURE
    async with asyncio.TaskGroup() as group:
        group.create_task(ScannerSupervisor(ours, deadline=6.0).run())
        with pytest.raises(RossecError, match="took too long, or failed"):
            await client.read(bomb)
        assert await client.read(qr.png(text)) == text
        await client.close()

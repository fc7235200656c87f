"""A beginner's path through the command line: README's commands, and every slip beside them.

A slip ends with an exit code, an error and a hint; it never shows a traceback and never loses or
changes what was there.
"""

import contextlib
import gc
import os
import re
import shutil
import socket
import sqlite3
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Final

import pytest

from rossec.cli.main import run

BIN: Final = Path(sys.executable).parent
ROOT: Final = Path(__file__).parents[2]
SECRET: Final = "four random words here"
POSE: Final = "geometry_msgs/PoseStamped"


class Home:
    """A ROSSEC_HOME and a person who types commands."""

    def __init__(self, path: Path, capsys: pytest.CaptureFixture[str] | None) -> None:
        self.path = path
        self.capsys = capsys
        self.passphrase = path.parent / f"{path.name}.passphrase"
        self.passphrase.touch(0o600)
        self.passphrase.write_text(SECRET + "\n")
        self.variables = {"ROSSEC_HOME": str(path), "ROS_IP": "127.0.0.1"}

    def __call__(self, *words: str) -> tuple[int, str, str]:
        """Run one command line: exit code, stdout, stderr."""
        code = run(words, self.variables)
        out, err = self.capsys.readouterr() if self.capsys is not None else ("", "")
        assert "Traceback" not in err
        return code, out, err

    def done(self, *words: str) -> str:
        code, out, err = self(*words)
        assert code == 0, err
        return out

    def secret(self, *words: str) -> tuple[str, ...]:
        """The words of a command that unlocks the authority's key."""
        return *words, "--passphrase-file", str(self.passphrase)

    def enroll(self, name: str) -> Path:
        """Request, sign and install."""
        self.done("node", "request", name)
        directory = self.path / "nodes" / name[1:]
        self.done(*self.secret("ca", "sign", str(directory / "node.csr"), "--yes"))
        self.done("node", "install", str(directory / "node.pem"), "--yes")
        return directory

    def slips(self, code: int, error: str, hint: str, *words: str) -> None:
        """The command ends with `code`, says both (patterns), and changes no file."""
        before = contents(self.path)
        ended, _, err = self(*words)
        assert re.fullmatch(
            f"(rossec: (?!error|hint).*\n)*rossec: error: .*{error}.*\nrossec: hint: .*{hint}.*\n",
            err,
        ), err  # fmt: skip
        assert ended == code
        assert contents(self.path) == before


def contents(path: Path) -> Mapping[str, bytes]:
    """Every file; of the authority's database what is in it, as SQLite moves its pages about."""
    files = (file for file in path.rglob("*") if file.is_file() and "ca.db-" not in file.name)
    return {
        str(file): dumped(file) if file.suffix == ".db" else file.read_bytes() for file in files
    }


def dumped(database: Path) -> bytes:
    with contextlib.closing(sqlite3.connect(database)) as connection:
        return "\n".join(connection.iterdump()).encode()


@pytest.fixture
def bare(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> Home:
    """Nothing done yet."""
    return Home(tmp_path / "bare", capsys)


@pytest.fixture(scope="module")
def template(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Made once: unlocking a key takes its time on purpose."""
    path = tmp_path_factory.mktemp("first") / "home"
    made = Home(path, None)
    made.done(*made.secret("ca", "init", "home"))
    made.enroll("/robot")
    made.enroll("/master")
    gc.collect()  # a record that is closed while it is copied takes its journal away
    return path


@pytest.fixture
def home(tmp_path: Path, template: Path, capsys: pytest.CaptureFixture[str]) -> Home:
    """An authority, an enrolled robot and a master."""
    shutil.copytree(template, tmp_path / "home")
    return Home(tmp_path / "home", capsys)


# --- README, to the letter


def quickstart() -> str:
    """The commands of README as printed."""
    text = (ROOT / "README.md").read_text()
    return text.partition("<!-- quickstart -->\n```\n")[2].partition("```")[0]


ANSWERS: Final = (
    *(SECRET, SECRET),  # ca init, twice
    *("y", SECRET),  # ca sign
    *("y", "y", "y"),  # node install
    *(SECRET, SECRET),  # grant sign
    *(SECRET, SECRET),  # grant revoke, ca revoke
)


def test_the_commands_of_the_readme_work_as_printed(tmp_path: Path) -> None:
    """Typed into one shell at a terminal, where a person answers; `rossec` is not installed."""
    port = free_port()
    printed = quickstart()
    # The only thing added: a person sees the master's first line before going on.
    started = "rossec master &"
    assert printed.count(f"\n{started} ") == 1
    script = tmp_path / "quickstart.sh"
    waits = re.sub(rf"(?m)^{started}.*$", rf"\g<0>\n{READY}", printed)
    script.write_text(f"set -e\ntrap 'kill $(jobs -p) 2>/dev/null || true' EXIT\n{waits}")
    env = {
        "HOME": str(tmp_path), "PATH": "/usr/bin:/bin", "PORT": str(port), "TERM": "dumb",
        "ROS_MASTER_URI": f"http://127.0.0.1:{port}/",
    }  # fmt: skip
    typed = [sys.executable, "-m", "tests.support.terminal", *ANSWERS, "--"]
    done = subprocess.run(
        [*typed, "/bin/bash", str(script)],
        env=env, cwd=ROOT, text=True, capture_output=True, timeout=100, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr
    assert "Traceback" not in done.stdout + done.stderr
    assert done.stdout.count("x: 4.0") == 2
    assert done.stdout.count("frame_id: \n") == 2
    assert done.stdout.count("the master has the new list") == 2


READY: Final = "until (: >/dev/tcp/127.0.0.1/$PORT) 2>/dev/null; do sleep 0.05; done"


def free_port() -> int:
    with socket.create_server(("127.0.0.1", 0)) as server:
        port: int = server.getsockname()[1]
        return port


# --- slips


def test_there_is_no_authority_yet(bare: Home, tmp_path: Path) -> None:
    (tmp_path / "request").write_bytes(b"x")
    for words in (
        ("ca", "show"),
        ("ca", "sign", str(tmp_path / "request")),
        ("ca", "publish"),
        ("grant", "list"),
        ("grant", "sign", "/robot", "--publish", "/x"),
        ("grant", "revoke", "00"),
    ):
        bare.slips(1, "there is no authority in ", "rossec ca init DOMAIN", *words)


def test_a_passphrase_too_short(bare: Home) -> None:
    bare.passphrase.write_text("short")
    words = bare.secret("ca", "init", "home")
    bare.slips(1, "a passphrase of 5 characters", "at least 12", *words)
    assert not bare.path.exists()


def test_a_passphrase_file_that_is_empty_or_open_to_others(home: Home) -> None:
    words = home.secret("grant", "sign", "/robot", "--publish", "/x")
    home.passphrase.chmod(0o644)
    home.slips(1, "can be read by others", f"chmod 600 {home.passphrase}", *words)
    home.passphrase.chmod(0o600)
    home.passphrase.write_text("")
    home.slips(1, "is empty", "first line", *words)


def test_a_wrong_passphrase(home: Home) -> None:
    home.passphrase.write_text("four other words here")
    for words in (
        ("grant", "sign", "/robot", "--publish", "/x"),
        ("ca", "sign", str(home.path / "nodes/robot/node.csr"), "--yes"),
    ):
        home.slips(1, "passphrase", "", *home.secret(*words))


def test_an_authority_where_there_is_one(home: Home) -> None:
    home.slips(1, "there is an authority in", "ROSSEC_HOME", *home.secret("ca", "init", "home"))


def test_a_domain_or_a_name_that_is_none(bare: Home) -> None:
    bare.slips(1, "My Home", "", *bare.secret("ca", "init", "My Home"))
    for name in ("robot", "/", "/a b", "/../x", "/a//b"):
        bare.slips(1, "", "", "node", "request", name)
    assert not bare.path.exists()


def test_signing_what_is_missing_or_no_request(home: Home, tmp_path: Path) -> None:
    missing = tmp_path / "node.csr"
    home.slips(2, "does not exist", "ca sign --help", *home.secret("ca", "sign", str(missing)))
    missing.write_bytes(b"no request")
    home.slips(1, "", "", *home.secret("ca", "sign", str(missing), "--yes"))


def test_not_saying_yes(home: Home, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("click.confirm", lambda *_args, **_options: False)
    pem = home.path / "nodes/robot/node.pem"
    home.slips(1, "nothing was done", "--yes", "node", "install", str(pem))


def test_requesting_twice(home: Home) -> None:
    home.slips(1, "", "", "node", "request", "/robot")


def test_the_code_of_another_request(home: Home) -> None:
    home.done("node", "request", "/door")
    text = home.done("node", "code", "/robot", "--text").strip()
    request = home.path / "nodes/door/node.csr"
    words = home.secret("ca", "sign", str(request), "--code", text, "--yes")
    home.slips(1, "does not fit the codes", "scan the code again", *words)
    words = home.secret("ca", "sign", str(request), "--code", text[:-3], "--yes")
    home.slips(1, "", "", *words)


def test_installing_before_signing(home: Home) -> None:
    home.done("node", "request", "/door")
    pem = home.path / "nodes/door/node.pem"
    home.slips(2, "does not exist", "node install --help", "node", "install", str(pem))
    home.slips(1, "/door has no ca.pem", "rossec ca sign .*node.csr", "node", "show", "/door")


def test_installing_the_identity_of_another_node(home: Home, tmp_path: Path) -> None:
    """On the door's machine, with the file that was meant for the robot."""
    elsewhere = Home(tmp_path / "elsewhere", home.capsys)
    elsewhere.done("node", "request", "/robot")
    pem = home.path / "nodes/robot/node.pem"
    words = ("node", "install", str(pem), "--yes")
    elsewhere.slips(1, "with another key", "sign the request in", *words)
    nobody = Home(tmp_path / "nobody", home.capsys)
    nobody.slips(1, "", "", *words)


def test_installing_an_identity_of_another_authority(home: Home, tmp_path: Path) -> None:
    other = Home(tmp_path / "other", home.capsys)
    other.done(*other.secret("ca", "init", "home"))
    request = tmp_path / "door.csr"
    shutil.copy(home.path / "nodes/robot/node.csr", request)
    other.done(*other.secret("ca", "sign", str(request), "--yes"))
    words = ("node", "install", str(tmp_path / "door.pem"), "--yes")
    home.slips(1, "/robot trusts another authority already", "enroll the node anew", *words)


SIGN: Final = ("grant", "sign", "/robot")
SUBSCRIBE: Final = (*SIGN, "--subscribe", "/robot/pose")


@pytest.mark.parametrize(
    ("error", "hint", "words"),
    [
        ("fram_id", "frame_id", (*SUBSCRIBE, "--type", POSE, "--clear", "header.fram_id")),
        ("Poze", "PoseStamped", (*SUBSCRIBE, "--type", "geometry_msgs/Poze", "--clear", "x")),
        ("message type", "--type", (*SUBSCRIBE, "--clear", "header.frame_id")),
        ("no step", "pose.position=2.0", (*SUBSCRIBE, "--type", POSE, "--round", "pose.position")),
        ("", "", (*SUBSCRIBE, "--type", POSE, "--round", "pose.position=-1")),
        ("", "", (*SUBSCRIBE, "--type", POSE, "--round", "pose.position=nan")),
        ("", "", (*SUBSCRIBE, "--type", POSE, "--round", "header.frame_id=2")),
        ("", "", (*SUBSCRIBE, "--type", POSE, "--when", "msg.header.frame_id = 'map'")),
        ("", "", (*SUBSCRIBE, "--type", POSE, "--when", "msg.header.fram_id == 'map'")),
        ("", "", (*SUBSCRIBE, "--type", POSE, "--when", "now.getHour() >= 6")),
        ("", "", (*SIGN, "--subscribe", "robot/pose")),
        ("", "", (*SIGN, "--subscribe", "/robot/po*")),
        ("allows nothing", "--publish", SIGN),
        ("restrict", "--subscribe", (*SIGN, "--publish", "/x", "--type", POSE, "--clear", "pose")),
        ("/rbot has no", "node request /rbot", ("grant", "sign", "/rbot", "--publish", "/x")),
    ],
)  # fmt: skip
def test_a_grant_with_a_slip(home: Home, error: str, hint: str, words: tuple[str, ...]) -> None:
    home.slips(1, error, hint, *home.secret(*words))


@pytest.mark.parametrize("text", ["7", "7days", "d", "-1d", "0d", "1.5h", "1y"])
def test_a_duration_that_is_none(home: Home, text: str) -> None:
    words = home.secret(*SIGN, "--publish", "/x", "--for", text)
    home.slips(2, "is not a duration", "grant sign --help", *words)


@pytest.mark.parametrize("beginning", ["", "zz", "00"])
def test_revoking_what_is_not_known(home: Home, beginning: str) -> None:
    words = home.secret("grant", "revoke", beginning)
    home.slips(1, "no grant begins with", "rossec grant list", *words)


def test_revoking_while_the_master_is_away_keeps_the_revocation(home: Home) -> None:
    told = home.done(*home.secret(*SIGN, "--publish", "/x"))
    home.variables["ROS_MASTER_URI"] = f"http://127.0.0.1:{free_port()}/"
    code, out, err = home(*home.secret("grant", "revoke", told.split()[1]))
    assert code == 3
    assert out.startswith(f"revoked {told.split()[1]} (list 2)\n")
    assert re.fullmatch("rossec: error: .* did not take the list.*\nrossec: hint: .*publish\n", err)
    assert home.done("grant", "list").rstrip().endswith("revoked")
    code, _, err = home("ca", "publish")
    assert (code, "hint: " in err) == (3, True)


def test_a_node_whose_master_is_not_running(home: Home) -> None:
    home.variables["ROS_MASTER_URI"] = f"http://127.0.0.1:{free_port()}/"
    words = ("topic", "echo", "/robot/pose", POSE, "--as", "/robot")
    home.slips(1, "cannot connect to 127.0.0.1 port", "is the peer running", *words)


@pytest.mark.parametrize("uri", ["localhost:11311", "http://localhost", "http://", "11311", ""])
@pytest.mark.parametrize(
    "words", [("topic", "echo", "/x", POSE, "--as", "/robot"), ("ca", "publish"), ("master",)]
)
def test_a_master_uri_that_is_none(home: Home, uri: str, words: tuple[str, ...]) -> None:
    home.variables["ROS_MASTER_URI"] = uri
    home.slips(1, "", "", *words)


def test_a_home_that_is_no_absolute_path(home: Home) -> None:
    home.variables["ROSSEC_HOME"] = "home"
    code, _, err = home("ca", "show")
    assert (code, err.count("\n")) == (1, 2)
    assert "absolute path" in err


def test_a_node_that_is_not_enrolled(home: Home) -> None:
    words = ("topic", "echo", "/robot/pose", POSE, "--as", "/nobody")
    home.slips(1, "/nobody has no ", "rossec node request /nobody", *words)
    shutil.rmtree(home.path / "nodes/master")
    home.slips(1, "/master has no ", "rossec node request /master", "master", "--port", "0")


def test_a_message_that_does_not_fit(home: Home) -> None:
    publish = ("topic", "pub", "/x", "std_msgs/String", "--as", "/robot")
    for content in ("{dat: hello}", "{data: [}", "hello", "[1]"):
        home.slips(1, "", "", *publish[:4], content, *publish[4:])


@pytest.mark.parametrize(
    "words", [("grnt",), ("grant", "sing"), ("ca", "init"), (*SIGN, "--publish", "/x", "--oops")]
)  # fmt: skip
def test_a_command_that_is_none(home: Home, words: tuple[str, ...]) -> None:
    home.slips(2, "", "--help", *words)


def test_an_interrupted_prompt_loses_nothing(home: Home) -> None:
    """Ctrl-C at the passphrase."""
    before = contents(home.path)
    command = (str(BIN / "rossec"), *SIGN, "--publish", "/x")
    done = subprocess.run(
        [sys.executable, "-m", "tests.support.terminal", "^C", "--", *command],
        env={**os.environ, **home.variables}, cwd=ROOT,
        text=True, capture_output=True, timeout=100, check=False,
    )  # fmt: skip
    assert done.returncode == 130
    assert done.stdout.startswith("passphrase of the authority's key: ")
    assert "Traceback" not in done.stdout + done.stderr
    assert contents(home.path) == before

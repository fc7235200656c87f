"""Wrong first steps at the command line.

A wrong command ends with an exit code, an error and a hint; it never shows a traceback and never
loses or changes what was there.
"""

import contextlib
import gc
import os
import re
import shutil
import sqlite3
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Final

import pytest

from rossec.cli.main import run
from tests.support.ports import free_port

BIN: Final = Path(sys.executable).parent


ROOT: Final = Path(__file__).parents[2]


SECRET: Final = "four random words here"


POSE: Final = "geometry_msgs/PoseStamped"


class Home:
    """A ROSSEC_HOME, and commands in it."""

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
        """The arguments of a command that unlocks the authority's key."""
        return *words, "--passphrase-file", str(self.passphrase)

    def enroll(self, name: str) -> Path:
        """Request, sign and install."""
        self.done("node", "request", name)
        directory = self.path / "nodes" / name[1:]
        self.done(*self.secret("ca", "sign", str(directory / "node.csr"), "--yes"))
        self.done("node", "install", str(directory / "node.pem"), "--yes")
        return directory

    def refuses(self, code: int, error: str, hint: str, *words: str) -> None:
        """The command ends with `code`, prints both (patterns), and changes no file."""
        before = contents(self.path)
        ended, _, err = self(*words)
        assert re.fullmatch(
            f"(rossec: (?!error|hint).*\n)*rossec: error: .*{error}.*\nrossec: hint: .*{hint}.*\n", err
        ), err
        assert ended == code
        assert contents(self.path) == before


def contents(path: Path) -> Mapping[str, bytes]:
    """Every file; for the authority's database its rows, as SQLite moves pages."""
    files = (file for file in path.rglob("*") if file.is_file() and "ca.db-" not in file.name)
    return {str(file): dumped(file) if file.suffix == ".db" else file.read_bytes() for file in files}


def dumped(database: Path) -> bytes:
    with contextlib.closing(sqlite3.connect(database)) as connection:
        return "\n".join(connection.iterdump()).encode()


@pytest.fixture
def bare(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> Home:
    """An empty home."""
    return Home(tmp_path / "bare", capsys)


@pytest.fixture(scope="module")
def template(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Made once: unlocking a key is slow on purpose."""
    path = tmp_path_factory.mktemp("first") / "home"
    made = Home(path, None)
    made.done(*made.secret("ca", "init", "home"))
    made.enroll("/robot")
    made.enroll("/master")
    gc.collect()  # a database that is closed while it is copied deletes its journal
    return path


@pytest.fixture
def home(tmp_path: Path, template: Path, capsys: pytest.CaptureFixture[str]) -> Home:
    """An authority, an enrolled robot and a master."""
    shutil.copytree(template, tmp_path / "home")
    return Home(tmp_path / "home", capsys)


def test_commands_without_an_authority_are_refused(bare: Home, tmp_path: Path) -> None:
    (tmp_path / "request").write_bytes(b"x")
    for words in (
        ("ca", "show"),
        ("ca", "sign", str(tmp_path / "request")),
        ("ca", "publish"),
        ("grant", "list"),
        ("grant", "sign", "/robot", "--publish", "/x"),
        ("grant", "revoke", "00"),
    ):
        bare.refuses(1, "there is no authority in ", "rossec ca init DOMAIN", *words)


def test_a_short_passphrase_is_refused(bare: Home) -> None:
    bare.passphrase.write_text("short")
    words = bare.secret("ca", "init", "home")
    bare.refuses(1, "a passphrase of 5 characters", "at least 12", *words)
    assert not bare.path.exists()


def test_a_passphrase_file_that_is_empty_or_open_to_others_is_refused(home: Home) -> None:
    words = home.secret("grant", "sign", "/robot", "--publish", "/x")
    home.passphrase.chmod(0o644)
    home.refuses(1, "can be read by others", f"chmod 600 {home.passphrase}", *words)
    home.passphrase.chmod(0o600)
    home.passphrase.write_text("")
    home.refuses(1, "is empty", "first line", *words)


def test_a_wrong_passphrase_is_refused(home: Home) -> None:
    home.passphrase.write_text("four other words here")
    for words in (
        ("grant", "sign", "/robot", "--publish", "/x"),
        ("ca", "sign", str(home.path / "nodes/robot/node.csr"), "--yes"),
    ):
        home.refuses(1, "passphrase", "", *home.secret(*words))


def test_a_second_authority_is_refused(home: Home) -> None:
    home.refuses(1, "there is an authority in", "ROSSEC_HOME", *home.secret("ca", "init", "home"))


def test_an_invalid_domain_or_name_is_refused(bare: Home) -> None:
    bare.refuses(1, "My Home", "", *bare.secret("ca", "init", "My Home"))
    for name in ("robot", "/", "/a b", "/../x", "/a//b"):
        bare.refuses(1, "", "", "node", "request", name)
    assert not bare.path.exists()


def test_a_missing_or_invalid_request_is_not_signed(home: Home, tmp_path: Path) -> None:
    missing = tmp_path / "node.csr"
    home.refuses(2, "does not exist", "ca sign --help", *home.secret("ca", "sign", str(missing)))
    missing.write_bytes(b"no request")
    home.refuses(1, "", "", *home.secret("ca", "sign", str(missing), "--yes"))


def test_without_a_yes_nothing_is_done(home: Home, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("click.confirm", lambda *_args, **_options: False)
    pem = home.path / "nodes/robot/node.pem"
    home.refuses(1, "nothing was done", "--yes", "node", "install", str(pem))


def test_a_second_request_is_refused(home: Home) -> None:
    home.refuses(1, "", "", "node", "request", "/robot")


def test_the_code_of_another_request_is_refused(home: Home) -> None:
    home.done("node", "request", "/door")
    text = home.done("node", "code", "/robot", "--text").strip()
    request = home.path / "nodes/door/node.csr"
    words = home.secret("ca", "sign", str(request), "--code", text, "--yes")
    home.refuses(1, "does not fit the codes", "scan the code again", *words)
    words = home.secret("ca", "sign", str(request), "--code", text[:-3], "--yes")
    home.refuses(1, "", "", *words)


def test_an_identity_that_is_not_signed_is_not_installed(home: Home) -> None:
    home.done("node", "request", "/door")
    pem = home.path / "nodes/door/node.pem"
    home.refuses(2, "does not exist", "node install --help", "node", "install", str(pem))
    home.refuses(1, "/door has no ca.pem", "rossec ca sign .*node.csr", "node", "show", "/door")


def test_the_identity_of_another_node_is_not_installed(home: Home, tmp_path: Path) -> None:
    """On the door's machine, with the robot's file."""
    elsewhere = Home(tmp_path / "elsewhere", home.capsys)
    elsewhere.done("node", "request", "/robot")
    pem = home.path / "nodes/robot/node.pem"
    words = ("node", "install", str(pem), "--yes")
    elsewhere.refuses(1, "with another key", "sign the request in", *words)
    nobody = Home(tmp_path / "nobody", home.capsys)
    nobody.refuses(1, "", "", *words)


def test_the_identity_of_another_authority_is_not_installed(home: Home, tmp_path: Path) -> None:
    other = Home(tmp_path / "other", home.capsys)
    other.done(*other.secret("ca", "init", "home"))
    request = tmp_path / "door.csr"
    shutil.copy(home.path / "nodes/robot/node.csr", request)
    other.done(*other.secret("ca", "sign", str(request), "--yes"))
    words = ("node", "install", str(tmp_path / "door.pem"), "--yes")
    home.refuses(1, "/robot trusts another authority already", "enroll the node anew", *words)


SIGN: Final = ("grant", "sign", "/robot")


SUBSCRIBE: Final = (*SIGN, "--subscribe", "/robot/pose")


@pytest.mark.parametrize(
    ("error", "hint", "words"),
    [
        ("fram_id", "frame_id", (*SUBSCRIBE, "--type", POSE, "--clear", "header.fram_id")),
        ("Poze", "_msgs/Pose", (*SUBSCRIBE, "--type", "geometry_msgs/Poze", "--clear", "x")),
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
)
def test_a_grant_with_a_mistake_is_not_signed(
    home: Home, error: str, hint: str, words: tuple[str, ...]
) -> None:
    home.refuses(1, error, hint, *home.secret(*words))


@pytest.mark.parametrize("text", ["7", "7days", "d", "-1d", "0d", "1.5h", "1y"])
def test_an_invalid_duration_is_refused(home: Home, text: str) -> None:
    words = home.secret(*SIGN, "--publish", "/x", "--for", text)
    home.refuses(2, "is not a duration", "grant sign --help", *words)


@pytest.mark.parametrize("beginning", ["", "zz", "00"])
def test_an_unknown_grant_is_not_revoked(home: Home, beginning: str) -> None:
    words = home.secret("grant", "revoke", beginning)
    home.refuses(1, "no grant begins with", "rossec grant list", *words)


def test_a_revocation_is_kept_while_the_master_is_down(home: Home) -> None:
    told = home.done(*home.secret(*SIGN, "--publish", "/x"))
    home.variables["ROS_MASTER_URI"] = f"http://127.0.0.1:{free_port()}/"
    code, out, err = home(*home.secret("grant", "revoke", told.split()[1]))
    assert code == 3
    assert out.startswith(f"revoked {told.split()[1]} (list 2)\n")
    assert re.fullmatch("rossec: error: .* did not take the list.*\nrossec: hint: .*publish\n", err)
    assert home.done("grant", "list").rstrip().endswith("revoked")
    code, _, err = home("ca", "publish")
    assert (code, "hint: " in err) == (3, True)


def test_a_node_without_a_running_master_is_refused(home: Home) -> None:
    home.variables["ROS_MASTER_URI"] = f"http://127.0.0.1:{free_port()}/"
    words = ("topic", "echo", "/robot/pose", POSE, "--as", "/robot")
    home.refuses(1, "cannot connect to 127.0.0.1 port", "start it: rossec master", *words)


@pytest.mark.parametrize("uri", ["localhost:11311", "http://localhost", "http://", "11311", ""])
@pytest.mark.parametrize(
    "words", [("topic", "echo", "/x", POSE, "--as", "/robot"), ("ca", "publish"), ("master",)]
)
def test_an_invalid_master_uri_is_refused(home: Home, uri: str, words: tuple[str, ...]) -> None:
    home.variables["ROS_MASTER_URI"] = uri
    home.refuses(1, "", "", *words)


def test_a_relative_home_is_refused(home: Home) -> None:
    home.variables["ROSSEC_HOME"] = "home"
    code, _, err = home("ca", "show")
    assert (code, err.count("\n")) == (1, 2)
    assert "absolute path" in err


def test_a_node_that_is_not_enrolled_is_refused(home: Home) -> None:
    words = ("topic", "echo", "/robot/pose", POSE, "--as", "/nobody")
    home.refuses(1, "/nobody has no ", "rossec node request /nobody", *words)
    shutil.rmtree(home.path / "nodes/master")
    home.refuses(1, "/master has no ", "rossec node request /master", "master", "--port", "0")


def test_an_invalid_message_is_refused(home: Home) -> None:
    publish = ("topic", "pub", "/x", "std_msgs/String", "--as", "/robot")
    for content in ("{dat: hello}", "{data: [}", "hello", "[1]"):
        home.refuses(1, "", "", *publish[:4], content, *publish[4:])


@pytest.mark.parametrize(
    "words", [("grnt",), ("grant", "sing"), ("ca", "init"), (*SIGN, "--publish", "/x", "--oops")]
)
def test_an_unknown_command_is_refused(home: Home, words: tuple[str, ...]) -> None:
    home.refuses(2, "", "--help", *words)


def test_an_interrupted_prompt_loses_nothing(home: Home) -> None:
    """Ctrl-C at the passphrase."""
    before = contents(home.path)
    command = (str(BIN / "rossec"), *SIGN, "--publish", "/x")
    done = subprocess.run(
        [sys.executable, "-m", "tests.support.terminal", "^C", "--", *command],
        env={**os.environ, **home.variables},
        cwd=ROOT,
        text=True,
        capture_output=True,
        timeout=100,
        check=False,
    )
    assert done.returncode == 130
    assert done.stdout.startswith("passphrase of the authority's key: ")
    assert "Traceback" not in done.stdout + done.stderr
    assert contents(home.path) == before

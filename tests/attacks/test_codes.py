"""Misleading codes and names: reused, with control characters, or with lookalikes."""

import shutil
import time
from pathlib import Path

import pytest

from ca.enrollment import qr
from ca.errors import CodeRefused
from ca.store.values import RequestState
from rossec.authority.home import AuthorityHome
from tests.support.commands import PASSPHRASE, Said, Shell
from tests.support.enrolling import Robot, WaitingRobot

pytestmark = [pytest.mark.attack("misleading-code"), pytest.mark.timeout(600)]


@pytest.fixture(scope="module")
def authority(tmp_path_factory: pytest.TempPathFactory) -> Path:
    home = tmp_path_factory.mktemp("authority") / "home"
    return AuthorityHome.create(home, "home", PASSPHRASE, int(time.time())).path


@pytest.fixture
def shell(tmp_path: Path, capsys: pytest.CaptureFixture[str], authority: Path) -> Shell:
    shell = Shell(tmp_path / "home", capsys)
    shutil.copytree(authority, shell.root / "ca")
    return shell


def enroll(shell: Shell, robot: WaitingRobot, *more: str) -> Said:
    return shell.unlocked("ca", "enroll", robot.code, "--address", robot.where, "--yes", *more)


def certificates(shell: Shell, name: str) -> list[bytes]:
    rows = AuthorityHome.at(shell.root).store().identities.all()
    return [row.der for row in rows if row.name == name]


def test_a_reused_label_gives_the_same_identity(shell: Shell) -> None:
    """It authenticates one request for years, which has one answer."""
    robot = Robot()
    for _ in range(2):
        with WaitingRobot(robot, label=True) as waiting:
            assert enroll(shell, waiting).code == 0
    assert len(certificates(shell, robot.name)) == 1


def test_a_label_used_for_another_key(shell: Shell) -> None:
    label, thief = WaitingRobot(Robot(), label=True), Robot()
    with WaitingRobot(thief, label=True) as waiting:
        said = shell.unlocked("ca", "enroll", qr.label_code(Robot().csr), "--address", waiting.where, "--yes")
    assert said.code == 1
    assert certificates(shell, thief.name) == []
    assert label.trusted == []


def test_a_label_of_a_robot_that_was_revoked(shell: Shell) -> None:
    robot = Robot()
    with WaitingRobot(robot, label=True) as waiting:
        assert enroll(shell, waiting).code == 0
    nobody = ("--master", "http://127.0.0.1:1")
    assert shell.unlocked("ca", "revoke", robot.name, *nobody).code in {0, 3}
    with WaitingRobot(robot, label=True) as waiting:
        said = enroll(shell, waiting)
    assert said.code == 1, said
    assert "revoked" in said.err
    assert len(certificates(shell, robot.name)) == 1


def test_a_label_that_was_denied(shell: Shell) -> None:
    robot = Robot()
    with WaitingRobot(robot, label=True) as waiting:
        assert enroll(shell, waiting, "--later").code == 0
        (row,) = [
            row for row in AuthorityHome.at(shell.root).store().requests.all() if row.name == robot.name
        ]
        assert shell("ca", "deny", row.digest.hex()[:8]).code == 0
    with WaitingRobot(robot, label=True) as waiting:
        said = enroll(shell, waiting)
    assert said.code == 1, said
    assert certificates(shell, robot.name) == []
    states = [row.state for row in AuthorityHome.at(shell.root).store().requests.all()]
    assert RequestState.DENIED in states


ADDRESSES = [
    "\x1b[2J\x1b[H:1",
    "a\x00b:1",
    "a\nrossec: enrolled:1",
    "\x07:1",
    "a b:1",
    "a..b:1",
    "a" * 64,
    "-rf:1",
    "[::1%\x1b[2J]:1",
    "../x:1",
    "a:00000000001",
    "http://a/:1",
    ":1",
    "[]:1",
]


@pytest.mark.parametrize("address", ADDRESSES, ids=ascii)
def test_an_invalid_address(shell: Shell, address: str) -> None:
    later = int(time.time()) + 300
    code = qr.screen_code(b"request", bytes(16), later, address)
    said = shell.unlocked("ca", "enroll", code, "--yes")
    assert said.code == 1, said
    assert not {"\x1b", "\x07", "\x00"} & {*said.out, *said.err}
    assert "\nrossec: enrolled" not in said.err
    assert said.err.startswith("rossec: error: ")


GOOD = qr.label_code(b"request")
CODES = [
    GOOD + "\x00",
    GOOD + "\u200b",
    "\u200b" + GOOD,
    GOOD.replace("R", "\u0280", 1),
    GOOD.lower(),
    GOOD[:-1],
    GOOD + GOOD[7:],
    GOOD.replace(GOOD[9], "\uff21", 1),
    "\u202e" + GOOD[::-1],
    GOOD[:20] + "\n" + GOOD[20:],
    "ROSSEC:",
    "",
    "-",
    "--yes",
    GOOD[:12] + "\u0661" + GOOD[13:],
]


@pytest.mark.parametrize("code", CODES, ids=ascii)
def test_a_text_that_looks_like_a_code(shell: Shell, code: str) -> None:
    with pytest.raises(CodeRefused):
        qr.parse(code)
    secret = ("--passphrase-file", str(shell.secret))
    said = shell("ca", "enroll", "--yes", *secret, "--", code)
    assert said.code == 1
    assert said.err.isascii()


NAMES = [
    "/c\u0430mera",
    "/camera\u200b",
    "/camera\u202egpj",
    "/../camera",
    "/camera/..",
    "/a//b",
    "/a/",
    "/-rf",
    "//camera",
    "/camera\x00",
    "/camera\n",
    "/\uff43amera",
    "/a.b",
    "/a\\b",
    "~/a",
    "a",
    "",
    "/\u0131d",
    "/camera\x1b[2J",
    "/1a",
    "/cafe\u0301",
]


@pytest.mark.parametrize("name", NAMES, ids=ascii)
def test_an_invalid_name_creates_no_file(shell: Shell, name: str) -> None:
    before = sorted(shell.root.parent.rglob("*"))
    for words in (
        ("node", "request", "--", name),
        ("node", "labels", "--out", str(shell.root / "sheet.html"), "--", name),
        ("topic", "echo", "/x", "std_msgs/String", "--as", name),
        ("grant", "request", "--publish", "/x", "--why", "w", "--", name),
    ):
        said = shell(*words)
        assert said.code == 1, said
        assert said.err.isascii()
        assert not {"\x1b", "\x00"} & {*said.err}
    assert sorted(shell.root.parent.rglob("*")) == before


@pytest.mark.parametrize("domain", ["h\u043eme", "home\u200b", "HOME", "ho me", "home/x", "", "home\n"])
def test_a_domain_that_looks_like_another(shell: Shell, domain: str) -> None:
    said = shell("node", "request", "/camera", "--domain", domain)
    assert said.code == 1
    assert said.err.isascii()

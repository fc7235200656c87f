"""A ROSSEC_HOME that another user can write, who could replace the trust anchor.

Every command runs as its victim would run it, on a home that worked until then. Giving files to
another user takes root; without it those rows are not run, and the others are.
"""

import os
import pwd
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.support.commands import PASSPHRASE

pytestmark = [pytest.mark.attack("foreign-home"), pytest.mark.timeout(600)]

Change = Callable[[Path], None]
COMMANDS = {
    "a node": ("topic", "echo", "/chatter", "std_msgs/String", "--as", "/robot"),
    "its confirmation": ("node", "confirm", "/robot", "000000"),
    "the master": ("master", "--port", "0"),
    "finding the master": ("discover", "--as", "/robot", "--seconds", "0.3"),
    "the authority": ("ca", "list"),
    "a sidecar": ("run", "--as", "/robot", "--", "true"),
}


def rossec(home: Path, *words: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        (sys.executable, "-m", "rossec", *words),
        env={**os.environ, "ROSSEC_HOME": str(home), "ROS_IP": "127.0.0.1"},
        capture_output=True,
        text=True,
        check=False,
        timeout=300,
        stdin=subprocess.DEVNULL,
    )


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An authority and a node, made by the commands."""
    tmp_path = tmp_path_factory.mktemp("made")
    secret = tmp_path / "passphrase"
    secret.write_text(PASSPHRASE)
    secret.chmod(0o600)
    place = tmp_path / "home"
    unlocked = ("--passphrase-file", str(secret))
    bundle = str(place / "nodes" / "robot" / "node.pem")
    for words in (
        ("ca", "init", "home", *unlocked),
        ("node", "request", "/robot", "--domain", "home"),
        ("ca", "sign", str(place / "nodes" / "robot" / "node.csr"), "--yes", *unlocked),
        ("node", "install", bundle, "--yes"),
    ):
        done = rossec(place, *words)
        assert done.returncode == 0, done.stderr
    return place


@pytest.fixture
def home(made: Path, tmp_path: Path) -> Path:
    """A home for each test, below a directory of its own."""
    (tmp_path / "above").mkdir()
    return Path(shutil.copytree(made, tmp_path / "above" / "home"))


def refused(done: subprocess.CompletedProcess[str], *said: str) -> None:
    assert done.returncode != 0, done.stdout
    assert "Traceback" not in done.stderr
    for words in said:
        assert words in done.stderr


def opened(*parts: str, mode: int = 0o777) -> Change:
    return lambda home: home.joinpath(*parts).chmod(mode)


def given(*parts: str) -> Change:
    def change(home: Path) -> None:
        if os.geteuid() != 0:
            pytest.skip("NOT RUN: only root can change the owner of a file")
        os.chown(home.joinpath(*parts), pwd.getpwnam("nobody").pw_uid, -1)

    return change


@pytest.mark.parametrize("words", COMMANDS.values(), ids=COMMANDS)
def test_a_home_that_others_can_write(home: Path, words: tuple[str, ...]) -> None:
    home.chmod(0o777)
    refused(rossec(home, *words), "home can be written by others", "rossec: hint: ")


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (opened(".."), "above can be written by others"),
        (given(), "home belongs to nobody, who could change what root trusts"),
        (given(".."), "above belongs to nobody"),
    ],
    ids=["open above", "another's", "another's above"],
)
def test_a_home_of_another_user(home: Path, change: Change, said: str) -> None:
    change(home)
    refused(rossec(home, *COMMANDS["a node"]), said, "rossec: hint: ")


ROBOT = ("nodes", "robot")


@pytest.mark.parametrize(
    ("change", "words", "said"),
    [
        (opened("nodes"), "a node", "nodes can be written by others"),
        (opened(*ROBOT), "a node", "robot can be written by others"),
        (opened(*ROBOT, "ca.pem", mode=0o666), "a node", "ca.pem can be written by others"),
        (opened(*ROBOT, "ca.pem", mode=0o666), "finding the master", "ca.pem can be written"),
        (opened(*ROBOT, "node.pem", mode=0o666), "a node", "node.pem can be written by others"),
        (opened(*ROBOT, "grants"), "a node", "grants can be written by others"),
        (opened("ca"), "the authority", "ca can be written by others"),
        (opened("ca", "ca.db", mode=0o602), "the authority", "ca.db can be read or written"),
        (given(*ROBOT), "a node", "robot belongs to nobody"),
        (given(*ROBOT, "ca.pem"), "a node", "ca.pem belongs to nobody"),
        (given(*ROBOT, "node.key"), "a node", "node.key belongs to nobody"),
        (given("ca"), "the authority", "ca belongs to nobody"),
        (given("ca", "ca.db"), "the authority", "ca.db belongs to nobody"),
    ],
)
def test_a_part_of_the_home_that_others_can_write(home: Path, change: Change, words: str, said: str) -> None:
    path = home / "nodes" / "robot" / "grants"
    (path / f"{'00' * 16}.grant").write_bytes(b"something")
    change(home)
    refused(rossec(home, *COMMANDS[words]), said)


def test_an_anchor_behind_a_link(home: Path, tmp_path: Path) -> None:
    anchor = home / "nodes" / "robot" / "ca.pem"
    anchor.rename(tmp_path / "elsewhere.pem")
    anchor.symlink_to(tmp_path / "elsewhere.pem")
    refused(rossec(home, *COMMANDS["a node"]), "ca.pem is a symbolic link")


def test_a_home_behind_a_link_in_a_shared_directory(home: Path, tmp_path: Path) -> None:
    (tmp_path / "all").mkdir()
    (tmp_path / "all").chmod(0o777)
    (tmp_path / "all" / "link").symlink_to(home)
    refused(rossec(tmp_path / "all" / "link", "ca", "list"), "all can be written by others")


@pytest.mark.parametrize("mode", [0o666, 0o777])
def test_a_configuration_that_others_can_write(home: Path, mode: int) -> None:
    for name, text in (("master.yaml", "port: 0\n"), ("rossec.toml", "[rospy]\n")):
        (home / name).write_text(text)
        (home / name).chmod(mode)
    said = "can be written by others"
    refused(rossec(home, "master", "--config", str(home / "master.yaml")), f"master.yaml {said}")
    program = (
        "from rossec.inprocess import secure\ntry: secure._options(None, None)\n"
        "except Exception as error: raise SystemExit(str(error))"
    )
    done = subprocess.run(
        (sys.executable, "-c", program),
        env={**os.environ, "ROSSEC_HOME": str(home)},
        capture_output=True,
        text=True,
        check=False,
        timeout=300,
    )
    refused(done, f"rossec.toml {said}")


def test_a_policy_that_others_can_write(home: Path) -> None:
    policy = home / "ca" / "policy.yaml"
    policy.write_text("rossec: 1\nrobot: r\nrules: []\n")
    assert rossec(home, "grant", "pending").returncode == 0
    policy.chmod(0o666)
    for words in (("grant", "pending"), ("explain", "/robot", "publish", "/x")):
        refused(rossec(home, *words), "policy.yaml can be written by others")


def test_safe_homes_are_accepted(home: Path) -> None:
    """In a sticky directory, behind a link of one's own, and with a umask of 002."""
    home.parent.chmod(0o1777)
    for path in (home, *home.rglob("*")):
        if path.suffix != ".key" and path.name != "ca.db":
            path.chmod(path.stat().st_mode & ~0o020 | (0o020 if os.geteuid() == 0 else 0))
    (home.parent.parent / "link").symlink_to(home)
    for place in (home, home.parent.parent / "link"):
        done = rossec(place, "ca", "list")
        assert done.returncode == 0, done.stderr
        assert "/robot" in done.stdout

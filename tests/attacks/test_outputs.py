"""Links and devices at the path a command writes: their targets must not change."""

import os
import shutil
import stat
import time
from pathlib import Path

import pytest

from ca.errors import PathRefused
from rossec.authority.home import AuthorityHome
from rossec.master.server.effects import DenialLog
from tests.support.commands import PASSPHRASE, Shell

pytestmark = [pytest.mark.attack("linked-output"), pytest.mark.timeout(600)]

SROS2 = (
    '<policy><profile ns="/" node="n"><topics publish="ALLOW"><topic>x</topic></topics></profile></policy>'
)
POLICY = "rossec: 1\nrobot: r\nrules: []\n"
OUTPUTS: dict[str, tuple[str, ...]] = {
    "labels": ("node", "labels", "/robot", "--out", "OUT"),
    "a page": ("privacy", "--html", "OUT"),
    "a policy": ("policy", "import-sros2", "XML", "--out", "OUT"),
    "a grant": ("grant", "sign", "/robot", "--publish", "/x", "--out", "OUT", "SECRET"),
    "a request": ("grant", "request", "/robot", "--publish", "/x", "--why", "w", "--out", "OUT"),
    "a head": ("ca", "log", "head", "--out", "OUT", "SECRET"),
    "a backup": ("ca", "backup", "OUT", "SECRET"),
}


@pytest.fixture(scope="module")
def authority(tmp_path_factory: pytest.TempPathFactory) -> Path:
    home = tmp_path_factory.mktemp("authority") / "home"
    made = AuthorityHome.create(home, "home", PASSPHRASE, int(time.time()))
    (made.path / "policy.yaml").write_text(POLICY)
    return made.path


@pytest.fixture
def shell(tmp_path: Path, capsys: pytest.CaptureFixture[str], authority: Path) -> Shell:
    shell = Shell(tmp_path / "home", capsys)
    shutil.copytree(authority, shell.root / "ca")
    shell.enroll("/robot")
    (tmp_path / "policy.xml").write_text(SROS2)
    return shell


def run(shell: Shell, words: tuple[str, ...], out: Path) -> str:
    """Run a command that must fail; returns its output."""
    xml = shell.root.parent / "policy.xml"
    plain = [{"OUT": str(out), "XML": str(xml)}.get(word, word) for word in words if word != "SECRET"]
    said = shell.unlocked(*plain) if "SECRET" in words else shell(*plain)
    assert said.code == 1, said
    return said.err


@pytest.mark.parametrize("words", OUTPUTS.values(), ids=OUTPUTS)
def test_a_link_is_neither_followed_nor_replaced(
    shell: Shell, tmp_path: Path, words: tuple[str, ...]
) -> None:
    victim, out = tmp_path / "victim", tmp_path / "out"
    victim.write_text("precious")
    out.symlink_to(victim)
    assert "rossec: error: " in run(shell, words, out)
    assert victim.read_text() == "precious"
    assert out.is_symlink()
    out.unlink()
    out.symlink_to(tmp_path / "nothing")
    run(shell, words, out)
    assert not (tmp_path / "nothing").exists()


@pytest.mark.parametrize("words", OUTPUTS.values(), ids=OUTPUTS)
def test_a_pipe_stays_a_pipe(shell: Shell, tmp_path: Path, words: tuple[str, ...]) -> None:
    """As /dev/null and /dev/stdout must stay what they are, when root names them."""
    os.mkfifo(tmp_path / "out")
    run(shell, words, tmp_path / "out")
    assert stat.S_ISFIFO((tmp_path / "out").stat().st_mode)


@pytest.mark.parametrize("kind", ["link", "pipe", "another's"])
def test_a_log_in_a_shared_directory(tmp_path: Path, kind: str) -> None:
    """/tmp/complaints, created before by a user who wants to read it."""
    shared, log = tmp_path / "shared", tmp_path / "shared" / "denial_log"
    shared.mkdir()
    shared.chmod(0o1777)
    if kind == "link":
        log.symlink_to(tmp_path / "victim")
    elif kind == "pipe":
        os.mkfifo(log)
    else:
        log.touch()
        log.chmod(0o666)
    with pytest.raises((PathRefused, OSError)):
        DenialLog(log)
    assert not (tmp_path / "victim").exists()

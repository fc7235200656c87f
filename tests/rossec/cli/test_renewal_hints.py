"""No hint about an identity that ends leads in a circle: each is followed to where it works.

In the home of the how-tos: root, master and a node below one ROSSEC_HOME.
"""

import re
import time
from pathlib import Path
from typing import Final

import pytest

from rossec.home import NodeHome
from tests.support.commands import Said, Shell

LATE: Final = 31 * 86400
NOBODY: Final = ("--master", "http://127.0.0.1:1")


class Walk:
    """A user who types what hints say; the clock can be moved."""

    def __init__(self, shell: Shell, monkeypatch: pytest.MonkeyPatch, cwd: Path) -> None:
        self.shell = shell
        self._monkeypatch = monkeypatch
        monkeypatch.chdir(cwd)
        shell.enroll("/master")
        shell.enroll("/robot")

    def late(self) -> int:
        """From now on it is a day after the end of every identity of 30 days."""
        at = int(time.time()) + LATE
        for module in (
            "cli.ca.identities",
            "cli.ca.sign",
            "cli.shared.service",
            "cli.node.identity",
            "cli.node.doctor",
            "cli.grant.sign",
        ):
            self._monkeypatch.setattr(f"rossec.{module}.now", lambda: at, raising=False)
        return at

    def type(self, command: str) -> Said:
        """Type a command of a hint, with the passphrase."""
        words = command.split()[1:]
        secret = words[:2] != ["node", "install"]
        return self.shell.unlocked(*words) if secret else self.shell(*words, "--yes")

    def hint(self, said: Said, pattern: str) -> str:
        """The command in what was said that matches `pattern`."""
        found = re.search(pattern, said.err + said.out)
        assert found, said
        return found[0]


@pytest.fixture
def walk(shell: Shell, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Walk:
    return Walk(shell, monkeypatch, tmp_path)


BACK: Final = r"rossec ca renew --expired /robot"


def comes_back(walk: Walk, said: Said, at: int) -> None:
    """The hint's command works, and nothing more is to be done."""
    before = (walk.shell.node("/robot") / "node.key").read_bytes()
    assert said.code == 1
    done = walk.type(walk.hint(said, BACK))
    assert done.code == 0, done
    assert NodeHome.of(walk.shell.root, "/robot").identity(at).name == "/robot"
    assert (walk.shell.node("/robot") / "node.key").read_bytes() == before


@pytest.mark.parametrize(
    "command",
    [
        ("ca", "renew", "/robot"),
        ("ca", "sign", "nodes/robot/node.csr", "--yes"),
        ("grant", "sign", "/robot", "--publish", "/pose", *NOBODY),
    ],
    ids=" ".join,
)
def test_commands_of_the_authority_lead_to_the_way_back(walk: Walk, command: tuple[str, ...]) -> None:
    words = [str(walk.shell.root / word) if "/node.csr" in word else word for word in command]
    at = walk.late()
    comes_back(walk, walk.shell.unlocked(*words), at)


@pytest.mark.parametrize(
    "command",
    [("node", "request", "/robot"), ("doctor", "/robot", "--offline"), ("node", "show", "/robot")],
    ids=" ".join,
)
def test_commands_of_the_node_lead_to_the_way_back(walk: Walk, command: tuple[str, ...]) -> None:
    at = walk.late()
    comes_back(walk, walk.shell(*command), at)


def test_a_bundle_is_carried_to_the_node(walk: Walk, tmp_path: Path) -> None:
    at = walk.late()
    away = walk.shell.node("/robot").rename(tmp_path / "away")
    done = walk.type("rossec ca renew --expired /robot")
    away.rename(walk.shell.node("/robot"))
    assert walk.type(walk.hint(done, r"rossec node install \S+")).code == 0
    assert NodeHome.of(walk.shell.root, "/robot").identity(at).name == "/robot"


def test_the_option_for_intermediates_leads_to_the_service(walk: Walk) -> None:
    """`--renew-identities` in the home of the root: the walk that ended where it had begun."""
    said = walk.shell.unlocked("master", "--port", "0", "--renew-identities")
    assert said.code == 1
    assert walk.hint(said, "leave it out, and run: rossec ca serve")
    assert "intermediate" not in said.err
    said = walk.shell.unlocked("ca", "intermediate", "request", "home")
    assert walk.hint(said, "whose service renews identities: rossec ca serve")
    elsewhere = walk.hint(said, r"ROSSEC_HOME=\S+ rossec ca intermediate request home")
    home, *words = elsewhere.split()
    other = Path(home.partition("=")[2].replace("~", str(walk.shell.root / "elsewhere")))
    other.mkdir(parents=True, mode=0o700)
    walk.shell.environ["ROSSEC_HOME"] = str(other)
    assert walk.shell.unlocked(*words[1:]).code == 0

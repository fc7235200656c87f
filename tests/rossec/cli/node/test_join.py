import io
import stat
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from ca.enrollment import invitation
from ca.enrollment.join import RefusedMessage, RefuseReason, WaitingMessage, WaitReason
from ca.errors import CertificateExpired
from rossec.cli.node import enroll as module
from rossec.home import NodeHome
from rossec.naming import rule_runner
from tests.support.commands import PASSPHRASE, Shell, refused
from tests.support.joining import JoinPort


def invited(shell: Shell, port: JoinPort | None, *words: str) -> str:
    address = "127.0.0.1:9" if port is None else port.address
    said = shell("ca", "invite", *words, "--address", address)
    assert said.code == 0, said.err
    return said.out


@pytest.fixture
def pasted(monkeypatch: pytest.MonkeyPatch) -> "Pasted":
    return Pasted(monkeypatch)


class Pasted:
    """Gives a code on standard input."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self._monkeypatch = monkeypatch

    def __call__(self, data: str | bytes) -> None:
        raw = data.encode() if isinstance(data, str) else data
        self._monkeypatch.setattr(sys, "stdin", io.TextIOWrapper(io.BytesIO(raw)))


def test_a_wrong_name_is_said_before_the_code_is_asked_for(shell: Shell, pasted: Pasted) -> None:
    pasted("no code")
    refused(shell("node", "join", "--name", "talker-1"), "not an absolute ROS name", "/talker_1")
    assert sys.stdin.read() == "no code"


def test_a_node_joins_with_one_command(shell: Shell, pasted: Pasted) -> None:
    with JoinPort(shell.root, PASSPHRASE) as port:
        pasted(invited(shell, port, "/fleet/robot07"))
        said = shell("node", "join")
    assert said.code == 0, said.err
    first, second = said.out.splitlines()
    assert first.startswith("authority of home, fingerprint ")
    assert second.startswith("/fleet/robot07 is enrolled until ")
    key = shell.node("/fleet/robot07") / "node.key"
    assert stat.S_IMODE(key.stat().st_mode) == 0o600
    assert "/fleet/robot07 of home" in shell("node", "show", "/fleet/robot07").out
    assert "1 of 1 joined" in shell("ca", "invitations", "--all").out


def test_a_second_run_changes_nothing(shell: Shell, pasted: Pasted) -> None:
    with JoinPort(shell.root, PASSPHRASE) as port:
        code = invited(shell, port, "/robot")
        pasted(code)
        assert shell("node", "join").code == 0
        before = (shell.node("/robot") / "node.pem").read_bytes()
        pasted(code)
        assert shell("node", "join").out == "/robot is enrolled already\n"
        assert len(port.requests) == 1
    assert (shell.node("/robot") / "node.pem").read_bytes() == before


def test_a_lost_answer_is_fetched_with_the_same_request(shell: Shell, pasted: Pasted) -> None:
    with JoinPort(shell.root, PASSPHRASE) as port:
        code = invited(shell, port, "/robot")
        pasted(code)
        assert shell("node", "join").code == 0
        (shell.node("/robot") / "node.pem").unlink()
        pasted(code)
        assert shell("node", "join").code == 0
        assert len({request.csr for request in port.requests}) == 1


def test_a_node_that_was_killed_before_its_request_was_written(shell: Shell, pasted: Pasted) -> None:
    with JoinPort(shell.root, PASSPHRASE) as port:
        code = invited(shell, port, "/robot")
        shell("node", "request", "/robot", "--domain", "elsewhere")
        for lost in (True, False):
            if lost:
                (shell.node("/robot") / "node.csr").unlink()
            pasted(code)
            assert shell("node", "join").code == 0


def test_the_code_of_a_file(shell: Shell, tmp_path: Path) -> None:
    file, tag = tmp_path / "code", tmp_path / "tag"
    with JoinPort(shell.root, PASSPHRASE) as port:
        file.write_text(invited(shell, port, "/*", "--uses", "2", "--ndef", str(tag)))
        said = shell("node", "join", "--file", str(file), "--name", "/a")
        assert said.code == 0, said.err
        assert "can be read by other users" in said.err
        said = shell("node", "join", "--file", str(tag), "--name", "/b")
    assert (said.code, said.err) == (0, "")


def test_anonymous_nodes(shell: Shell, pasted: Pasted) -> None:
    with JoinPort(shell.root, PASSPHRASE) as port:
        pasted(invited(shell, port, "/rviz", "--anonymous"))
        said = shell("node", "join")
    assert "/rviz and /rviz_* is enrolled until" in said.out
    assert NodeHome.find(shell.root, "/rviz_1_2").is_wildcard()


def test_the_name_is_required_for_a_pattern(shell: Shell, pasted: Pasted) -> None:
    code = invited(shell, None, "/fleet/**")
    pasted(code)
    refused(shell("node", "join"), "all names /fleet/**", "--name /fleet/robot07")
    for name in ("/other", "/fleet"):
        pasted(code)
        refused(shell("node", "join", "--name", name), f"not for {name}, but for /fleet/**")
    for name in ("/master", "/relay", "/gateway", "/gateway/attic"):
        pasted(invited(shell, None, "/**"))
        said = shell("node", "join", "--name", name)
        refused(said, f"{name} is reserved: no invitation", f"rossec node enroll {name}")
    assert not (shell.root / "nodes").exists()


@pytest.mark.parametrize(
    ("answer", "code", "error", "hint"),
    [
        (WaitingMessage(WaitReason.LOCKED), 5, "the authority is locked", "rossec ca unlock"),
        (WaitingMessage(WaitReason.PERSON), 5, "a person has to approve", "rossec ca requests"),
        (RefusedMessage(RefuseReason.ENDED), 1, "is used up", "rossec ca invite"),
    ],
)
def test_an_answer_that_is_no_identity(
    shell: Shell, pasted: Pasted, answer: WaitingMessage | RefusedMessage, code: int, error: str, hint: str
) -> None:
    with JoinPort(shell.root, PASSPHRASE) as port:
        line = invited(shell, port, "/robot")
        port.answers.append(answer)
        pasted(line)
        refused(shell("node", "join"), error, hint, code)
        pasted(line)
        assert shell("node", "join").code == 0
        first, second = port.requests
        assert first.csr == second.csr


def test_a_person_approves_a_known_name(shell: Shell, pasted: Pasted) -> None:
    shell.enroll("/robot")
    shell.node("/robot").rename(shell.root / "old")
    with JoinPort(shell.root, PASSPHRASE) as port:
        line = invited(shell, port, "/robot")
        pasted(line)
        refused(shell("node", "join"), "a person has to approve", code=5)
        waiting = shell("ca", "requests").out
        assert "pending  /robot  invitation " in waiting
        said = shell.unlocked("ca", "approve", waiting[:8], "--replace-key", "/robot")
        assert "approved /robot" in said.out
        pasted(line)
        assert shell("node", "join").code == 0


def test_another_authority_is_not_replaced(shell: Shell, pasted: Pasted) -> None:
    shell.enroll("/robot")
    code = invitation.parse(invited(shell, None, "/robot"))
    other = invitation.InvitationCode(bytes(32), code.secret, code.expires, code.address, "/robot")
    pasted(other.text())
    refused(shell("node", "join"), "trusts another authority already", "move ")


def test_nobody_answers(shell: Shell, pasted: Pasted) -> None:
    with JoinPort(shell.root, PASSPHRASE) as port:
        code = invited(shell, port, "/robot")
    pasted(code)
    refused(shell("node", "join"), "no authority answers at 127.0.0.1:", "rossec ca serve")


def test_a_late_code(shell: Shell, pasted: Pasted) -> None:
    code = invitation.InvitationCode(bytes(32), bytes(16), 1, "127.0.0.1:9", "/robot")
    pasted(code.text())
    refused(shell("node", "join"), "the invitation expired ", "clock")


@pytest.mark.parametrize("data", [b"", b"ROSSEC:AB", b"\xff\xfe", b"\xd2\x1b\x05rubbish", b"x" * 9999])
def test_no_code(shell: Shell, pasted: Pasted, data: bytes) -> None:
    pasted(data)
    said = shell("node", "join")
    assert said.code == 1
    assert "hint" in said.err


def test_a_terminal_is_asked_and_shows_nothing(shell: Shell, monkeypatch: pytest.MonkeyPatch) -> None:
    """Line by line until the code is whole: a mail has broken its line."""
    asked: list[str] = []

    def read_lines(question: str, is_whole: Callable[[str], bool]) -> str:
        asked.append(question)
        broken = [f"{line[at : at + 40]}\n" for at in range(0, len(line), 40)]
        taken = ["".join(broken[: end + 1]) for end in range(len(broken))]
        assert [is_whole(each) for each in taken] == [False] * (len(broken) - 1) + [True]
        return taken[-1]

    with JoinPort(shell.root, PASSPHRASE) as port:
        line = invited(shell, port, "/robot").strip()
        monkeypatch.setattr(sys.stdin, "isatty", lambda: True, raising=False)
        monkeypatch.setattr(module, "read_lines", read_lines)
        assert shell("node", "join").code == 0
    assert asked == ["the line of `rossec ca invite` (it is not shown)"]


def test_nothing_is_typed(shell: Shell, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys.stdin, "isatty", lambda: True, raising=False)
    monkeypatch.setattr(module, "read_lines", lambda *_: "\n")
    refused(shell("node", "join"), "no code was given", "--file")


def test_an_identity_that_has_expired_is_renewed_by_another_invitation(
    shell: Shell, pasted: Pasted, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With the key that the node has: it is the name's own, so no person is needed."""

    def expired(*_: object) -> None:
        raise CertificateExpired("the certificate expired")

    with JoinPort(shell.root, PASSPHRASE) as port:
        pasted(invited(shell, port, "/robot"))
        assert shell("node", "join").code == 0
        key = (shell.node("/robot") / "node.key").read_bytes()
        pasted(invited(shell, port, "/robot"))
        monkeypatch.setattr(NodeHome, "identity", expired)
        said = shell("node", "join")
        assert "/robot is enrolled until" in said.out, said.err
    assert (shell.node("/robot") / "node.key").read_bytes() == key


LAMP = b"<node><group>lamps</group><owner>ann</owner><name>desk</name></node>"


@pytest.fixture
def meta(tmp_path: Path) -> Path:
    path = tmp_path / "lamp.xml"
    path.write_bytes(LAMP)
    return path


def test_the_name_is_that_of_the_authority_s_rules(shell: Shell, pasted: Pasted, meta: Path) -> None:
    with JoinPort(shell.root, PASSPHRASE, rule_runner.shipped_rules()) as port:
        code = invited(shell, port, "/lamps/**")
        for answer in ("/lamps/ann/desk is enrolled until ", "/lamps/ann/desk is enrolled already"):
            pasted(code)
            said = shell("node", "join", "--meta", str(meta))
            assert said.code == 0, said.err
            assert answer in said.out
    assert [request.metadata for request in port.requests] == [LAMP]


def test_what_the_rules_do_not_give_is_refused(shell: Shell, pasted: Pasted, meta: Path) -> None:
    with JoinPort(shell.root, PASSPHRASE, rule_runner.shipped_rules()) as port:
        pasted(invited(shell, port, "/cameras/**"))
        refused(shell("node", "join", "--meta", str(meta)), "the invitation does not allow")
        meta.write_bytes(b"<node>")
        pasted(invited(shell, port, "/lamps/**"))
        refused(shell("node", "join", "--meta", str(meta)), "give no name", "rossec namespace name")
        meta.write_bytes(b"<node>" + b" " * 4096 + b"</node>")
        pasted(invited(shell, port, "/lamps/**"))
        refused(shell("node", "join", "--meta", str(meta)), "where 1 to 4096 are allowed")
    with JoinPort(shell.root, PASSPHRASE) as port:
        meta.write_bytes(LAMP)
        pasted(invited(shell, port, "/lamps/**"))
        said = shell("node", "join", "--meta", str(meta))
        refused(said, "the authority has no rules that give names", "rossec ca serve --rules FILE")
        assert port.requests == []
    assert not (shell.root / "nodes").exists()


def test_a_name_or_metadata(shell: Shell, meta: Path) -> None:
    said = shell("node", "join", "--meta", str(meta), "--name", "/a")
    assert said.code == 2
    assert "not both" in said.err

import io
from pathlib import Path

import pytest

from ca.certificates import from_pem
from ca.enrollment import qr
from ca.store.values import RequestState
from rossec.authority.home import AuthorityHome
from tests.support.commands import Said, Shell, refused
from tests.support.enrolling import Robot, WaitingRobot

POLICY = """rossec: 1
robot: r
identities: {camera: {node: /robot1/camera}}
types: {}
rules:
  - {id: see, who: camera, allow: {publish: [/image]}, why: it is a camera}
"""


def enroll(shell: Shell, robot: WaitingRobot, *more: str) -> Said:
    return shell.unlocked("ca", "enroll", robot.code, "--yes", *more)


def states(shell: Shell) -> list[RequestState]:
    rows = AuthorityHome.at(shell.root).store().requests.all()
    return [row.state for row in rows if row.name != "/ca"]


@pytest.mark.parametrize("host", ["127.0.0.1", "::1"])
def test_a_node_is_enrolled_by_its_code(shell: Shell, host: str) -> None:
    with WaitingRobot(Robot(), host=host) as robot:
        said = enroll(shell, robot)
    assert said.code == 0, said.err
    (trusted,) = robot.trusted
    lines = said.out.splitlines()
    assert lines[0] == "spiffe://home/robot1/camera asks for an identity"
    assert lines[2:5] == [
        f"  from a screen code at {robot.where}",
        "  /robot1/camera is new here",
        "  there is no policy: it is granted nothing",
    ]
    assert lines[5] == f"digits {trusted.digits[:3]} {trusted.digits[3:]}"
    assert lines[-1] == "enrolled /robot1/camera"
    assert trusted.root == AuthorityHome.at(shell.root).anchor().certificate
    assert states(shell) == [RequestState.ISSUED]


def test_the_projected_grants_are_shown(shell: Shell) -> None:
    (shell.root / "ca" / "policy.yaml").write_text(POLICY)
    with WaitingRobot(Robot()) as robot, WaitingRobot(Robot("/stranger")) as stranger:
        said = enroll(shell, robot)
        other = enroll(shell, stranger)
    assert "    allow publish /image (rule see: it is a camera)" in said.out
    assert "  the policy has no rule for it: deny" in other.out


def test_a_code_is_read_from_a_picture(shell: Shell, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with WaitingRobot(Robot()) as robot:
        (tmp_path / "photo.png").write_bytes(qr.png(robot.code))
        image = ("ca", "enroll", "--yes", "--image")
        assert shell.unlocked(*image, str(tmp_path / "photo.png")).code == 0
    with WaitingRobot(Robot("/other")) as robot:
        stdin = io.TextIOWrapper(io.BytesIO(qr.png(robot.code)))
        monkeypatch.setattr("sys.stdin", stdin)
        assert shell.unlocked(*image, "-").code == 0


def test_a_label_needs_an_address(shell: Shell) -> None:
    with WaitingRobot(Robot(), label=True) as robot:
        refused(enroll(shell, robot), "a label does not say where", "--address HOST")
        said = enroll(shell, robot, "--address", robot.where)
    assert said.code == 0, said.err
    assert f"  from a label at {robot.where}\n" in said.out
    assert len(robot.trusted) == 1


def test_the_typed_answer_decides(shell: Shell, monkeypatch: pytest.MonkeyPatch) -> None:
    with WaitingRobot(Robot()) as robot:
        asked = ("ca", "enroll", robot.code)
        monkeypatch.setattr("sys.stdin", io.StringIO(""))
        said = shell.unlocked(*asked)
        assert "there was no answer, nothing was done" in said.err
        assert states(shell) == [RequestState.PENDING]
        monkeypatch.setattr("sys.stdin", io.StringIO("n\n"))
        said = shell.unlocked(*asked)
        assert said.code == 1
        assert "rossec: error: denied\n" in said.err
        assert states(shell) == [RequestState.DENIED]
        refused(shell.unlocked(*asked), "is denied", "new request")
    assert robot.trusted == []


def test_a_request_is_recorded_for_later(shell: Shell) -> None:
    robot = Robot()
    with WaitingRobot(robot, label=True) as waiting:
        where = ("--address", waiting.where)
        said = enroll(shell, waiting, "--later", *where)
        assert said.code == 0
        request_id = said.out.split("rossec ca approve ")[1].split(",")[0]
        assert shell.unlocked("ca", "approve", request_id).code == 0
        said = shell.unlocked("ca", "enroll", waiting.code, *where)
        assert said.code == 0, said.err
        assert "enrolled with this key" in said.out
    assert len(waiting.trusted) == 1


def test_another_key_for_a_known_name_needs_replace_key(shell: Shell) -> None:
    with WaitingRobot(Robot()) as robot:
        assert enroll(shell, robot).code == 0
    with WaitingRobot(Robot()) as robot:
        said = enroll(shell, robot)
        assert "  WARNING: /robot1/camera is enrolled with ANOTHER KEY until " in said.out
        refused(said, "another key", "--replace-key /robot1/camera")
        assert robot.trusted == []
        replace = ("--replace-key", "/robot1/camera", "--master", "http://127.0.0.1:1")
        said = enroll(shell, robot, *replace)
        assert "enrolled /robot1/camera\nthe replaced key is revoked\n" in said.out
        refused(said, "did not take the list", "rossec ca publish", code=3)
    assert len(robot.trusted) == 1


def test_a_replaced_key_is_not_forgotten_when_the_node_refuses(shell: Shell) -> None:
    with WaitingRobot(Robot()) as robot:
        assert enroll(shell, robot).code == 0
    with WaitingRobot(Robot(), person=lambda _: "no digits") as robot:
        said = enroll(shell, robot, "--replace-key", "/robot1/camera")
    assert said.code == 1
    assert "deliver it with: rossec ca publish\nrossec: error: the node has ended the" in said.err
    assert len(AuthorityHome.at(shell.root).store().revoked_entries()) == 1


def test_a_node_is_enrolled_for_anonymous_nodes(shell: Shell) -> None:
    with WaitingRobot(Robot("/rviz", wildcard=True)) as robot:
        refused(enroll(shell, robot), "all names that begin with /rviz_", "--anonymous")
        said = enroll(shell, robot, "--anonymous")
    assert said.code == 0, said.err
    assert "under every name that begins with /rviz_" in said.out
    assert len(robot.trusted) == 1


def test_a_request_is_read_from_a_file(shell: Shell, tmp_path: Path) -> None:
    shell("node", "request", "/robot")
    csr = shell.node("/robot") / "node.csr"
    said = shell.unlocked("ca", "enroll", "--csr", str(csr), "--yes")
    assert said.code == 0, said.err
    assert "  from a file\n" in said.out
    assert said.out.endswith("at the node: rossec node install node.pem\n")
    assert len(from_pem(csr.with_name("node.pem").read_bytes())) == 2
    assert shell("node", "install", str(csr.with_name("node.pem")), "--yes").code == 0
    (tmp_path / "x.csr").write_bytes(b"x" * 9999)
    refused(shell("ca", "enroll", "--csr", str(tmp_path / "x.csr")), "where at most 2048")


def test_a_request_from_a_file_is_enrolled_over_the_network(shell: Shell, tmp_path: Path) -> None:
    robot = Robot()
    (tmp_path / "robot.csr").write_bytes(robot.csr)
    with WaitingRobot(robot, label=True) as waiting:
        words = ("--csr", str(tmp_path / "robot.csr"), "--address", waiting.where, "--yes")
        assert shell.unlocked("ca", "enroll", *words).code == 0
    assert len(waiting.trusted) == 1
    assert not (tmp_path / "robot.pem").exists()


def test_exactly_one_source_of_the_code_is_accepted(shell: Shell, tmp_path: Path) -> None:
    (tmp_path / "x").touch()
    for words in ((), ("ROSSEC:", "--image", str(tmp_path / "x"))):
        refused(shell("ca", "enroll", *words), "give a code, or --image", "--help", code=2)
    refused(shell("ca", "enroll", "https://example.com"), "not the text of a rossec code")


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def test_the_code_is_read_from_the_terminal(shell: Shell, monkeypatch: pytest.MonkeyPatch) -> None:
    with WaitingRobot(Robot()) as robot:
        monkeypatch.setattr("sys.stdin", Terminal(f"{robot.code}\n"))
        assert shell.unlocked("ca", "enroll", "--yes").code == 0
    monkeypatch.setattr("sys.stdin", Terminal(""))
    said = shell.unlocked("ca", "enroll", "--yes")
    assert said.code == 1
    assert "rossec: error: no code was given\nrossec: hint: paste the line" in said.err


def test_an_expired_code_is_refused(shell: Shell) -> None:
    text = qr.screen_code(Robot().csr, bytes(16), 1000, "127.0.0.1:9")
    refused(shell("ca", "enroll", text), "the code expired", "show a new one")


def test_an_unreachable_node_is_reported(shell: Shell) -> None:
    with WaitingRobot(Robot()) as robot:
        pass
    refused(enroll(shell, robot), "no node waits to be enrolled at", "rossec node enroll")


def test_a_denial_at_the_node_is_reported(shell: Shell) -> None:
    with WaitingRobot(Robot(), person=lambda _: "000000x") as robot:
        refused(enroll(shell, robot), "the node has ended the enrollment")

import json
from pathlib import Path

import pytest
from cryptography.hazmat.primitives.asymmetric import ec

from ca.encoding import Value, encode
from ca.keys.signer import KeySigner
from grants.claims import issuer_uri
from grants.document import GRANT
from tests.support.commands import Shell, refused

POSE = ("--type", "geometry_msgs/PoseStamped")


@pytest.fixture
def robot(shell: Shell) -> Shell:
    shell.enroll("/robot")
    return shell


def test_a_grant_reaches_its_node(robot: Shell) -> None:
    said = robot.unlocked(
        "grant", "sign", "/robot", "--publish", "/robot/**", "--graph", "--admin", "/talker"
    )
    assert said.out.startswith("grant ")
    assert f"given to /robot in {robot.node('/robot')}" in said.out
    (file,) = (robot.node("/robot") / "grants").iterdir()
    shown = robot("grant", "show", str(file)).out
    assert "may publish /robot/**" in shown
    assert "may graph /**" in shown
    assert "may admin /talker" in shown


def test_restrictions_are_said_in_words(robot: Shell, tmp_path: Path) -> None:
    out = tmp_path / "pose.grant"
    said = robot.unlocked(
        "grant", "sign", "/robot", "--subscribe", "/pose", *POSE,
        "--round", "pose.position=2.0", "--clear", "header.frame_id",
        "--when", 'msg.header.frame_id == "map"', "--for", "1h", "--out", str(out),
    )  # fmt: skip
    assert f"written to {out}" in said.out
    shown = robot("grant", "show", str(out)).out
    assert "pose.position: round step 2.0" in shown
    assert "header.frame_id: clear" in shown
    assert 'only when msg.header.frame_id == "map"' in shown


def test_every_right_over_names(robot: Shell, tmp_path: Path) -> None:
    out = tmp_path / "robot.grant"
    names = ("publish", "subscribe", "call", "provide", "param-get", "param-set")
    options = [word for name in names for word in (f"--{name}", f"/{name.replace('-', '_')}")]
    said = robot.unlocked("grant", "sign", "/robot", *options, "--out", str(out))
    assert said.code == 0, said.err
    shown = robot("grant", "show", str(out)).out
    for name in names:
        assert f"may {name} /{name.replace('-', '_')}\n" in shown


@pytest.mark.parametrize(
    ("options", "error", "hint"),
    [
        ((), "a grant that allows nothing", "--publish"),
        (("--publish", "pose"), "pose", ""),
        (("--publish", "/p", *POSE, "--clear", "header"), "what a subscriber sees", "--subscribe"),
        (("--subscribe", "/p", "--clear", "header"), "need the message type", "--type"),
        (("--subscribe", "/p", *POSE, "--clear", "heador"), "heador", ""),
        (("--subscribe", "/p", *POSE, "--round", "pose.position"), "has no step", "=2.0"),
        (("--subscribe", "/p", *POSE, "--round", "pose.position=-1"), "step", ""),
        (("--subscribe", "/p", *POSE, "--when", "msg.header.seq >"), "", ""),
        (("--subscribe", "/p", "--type", "geometry_msgs/Poze", "--clear", "x"), "Poze", ""),
    ],
)
def test_mistakes_show_before_anything_is_signed(
    robot: Shell, options: tuple[str, ...], error: str, hint: str
) -> None:
    refused(robot.unlocked("grant", "sign", "/robot", *options), error, hint)
    assert robot("grant", "list").out == ""


def test_a_duration_has_its_form(robot: Shell) -> None:
    said = robot.unlocked("grant", "sign", "/robot", "--publish", "/p", "--for", "forever")
    refused(said, "'forever' is no duration", code=2)


def test_nobody_unknown_gets_a_grant(shell: Shell) -> None:
    said = shell.unlocked("grant", "sign", "/nobody", "--publish", "/p")
    refused(said, "/nobody has no valid identity", "rossec node request /nobody")


def test_a_grant_for_a_node_elsewhere(robot: Shell, tmp_path: Path) -> None:
    away = tmp_path / "robot"
    robot.node("/robot").rename(away)
    said = robot.unlocked("grant", "sign", "/robot", "--publish", "/p")
    assert "sign with --out FILE" in said.err
    out = tmp_path / "p.grant"
    robot.unlocked("grant", "sign", "/robot", "--publish", "/p", "--out", str(out))
    away.rename(robot.node("/robot"))
    assert "/robot holds grant" in robot("grant", "install", str(out)).out
    out.write_bytes(out.read_bytes()[:-1] + b"\0")
    assert robot("grant", "install", str(out)).code == 1


def test_the_list_says_what_is_revoked(robot: Shell) -> None:
    robot.unlocked("grant", "sign", "/robot", "--publish", "/p")
    robot.unlocked("grant", "sign", "/robot", "--subscribe", "/q")
    first, second = (line.split()[0] for line in robot("grant", "list").out.splitlines())
    said = robot.unlocked("grant", "revoke", first[:8], "--master", "http://127.0.0.1:1")
    assert f"revoked {first}" in said.out
    refused(said, "did not take the list", "rossec ca publish", code=3)
    listed = json.loads(robot("grant", "list", "/robot", "--json").out)
    assert [(row["id"], row["revoked"]) for row in listed] == [(first, True), (second, False)]
    assert robot("grant", "list").out.splitlines()[0].endswith("revoked")
    assert robot("grant", "list", "/other").out == ""


def test_what_is_not_there_cannot_be_revoked(robot: Shell) -> None:
    refused(robot.unlocked("grant", "revoke", "00"), "no grant begins with '00'", "grant list")
    refused(robot.unlocked("grant", "revoke", ""), "no grant begins with ''")
    for _ in range(2):
        robot.unlocked("grant", "sign", "/robot", "--publish", "/p")
    ids = [line.split()[0] for line in robot("grant", "list").out.splitlines()]
    common = "" if ids[0][0] != ids[1][0] else ids[0][0]
    if common:
        refused(robot.unlocked("grant", "revoke", common), "several grants begin")


def test_a_slip_is_found_before_anything_is_signed(robot: Shell, tmp_path: Path) -> None:
    sign = ("grant", "sign", "/robot", "--publish", "/p")
    taken = tmp_path / "taken"
    taken.write_text("mine")
    said = robot.unlocked(*sign, "--out", str(taken))
    refused(said, "taken exists and is not overwritten", "give a new file")
    said = robot.unlocked(*sign, "--out", str(tmp_path / "missing" / "x"))
    refused(said, "there is no directory", "make it first")
    said = robot.unlocked(*sign, "--for", "3651d")
    refused(said, "at most 3650d are allowed", "grant sign --help", code=2)
    said = robot.unlocked("grant", "sign", "robot", "--publish", "/p")
    refused(said, "'robot' is not an absolute ROS name", "write it as /robot1/camera")
    assert robot("grant", "list").out == ""
    assert taken.read_text() == "mine"


@pytest.mark.parametrize("filters", [{7: {"clear": True}}, {"x": {7: True}}, {"x": {-1: {"a": 1}}}])
def test_a_filter_that_is_no_text_is_told_like_every_mistake(
    robot: Shell, tmp_path: Path, filters: dict[int | str, Value]
) -> None:
    scope: list[Value] = [["/pose", 2, {0: "geometry_msgs/PoseStamped", 2: filters}]]
    claims: dict[int | str, Value] = {
        1: issuer_uri(bytes(32)), 2: "/robot", 3: "home", 4: 2, 5: 1, 7: bytes(16),
        8: {5: bytes(32)}, 9: encode(scope), -65537: 2,
    }  # fmt: skip
    signer = KeySigner(ec.generate_private_key(ec.SECP256R1()))
    (tmp_path / "odd.grant").write_bytes(GRANT.sign(signer, claims))
    refused(robot("grant", "show", str(tmp_path / "odd.grant")), "in a grant: ")

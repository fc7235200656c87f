from pathlib import Path

import pytest

from grants.filters.compile import PRESETS
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


def test_restrictions_are_shown_as_text(robot: Shell, tmp_path: Path) -> None:
    out = tmp_path / "pose.grant"
    said = robot.unlocked(
        "grant",
        "sign",
        "/robot",
        "--subscribe",
        "/pose",
        *POSE,
        "--round",
        "pose.position=2.0",
        "--clear",
        "header.frame_id",
        "--when",
        'msg.header.frame_id == "map"',
        "--for",
        "1h",
        "--out",
        str(out),
    )
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
    refused(said, "'forever' is not a duration", code=2)


def test_a_node_that_is_not_enrolled_gets_no_grant(shell: Shell) -> None:
    said = shell.unlocked("grant", "sign", "/nobody", "--publish", "/p")
    refused(said, "/nobody has no valid identity", "rossec node request /nobody")


def test_a_grant_for_a_node_elsewhere(robot: Shell, tmp_path: Path) -> None:
    away = tmp_path / "robot"
    robot.node("/robot").rename(away)
    said = robot.unlocked("grant", "sign", "/robot", "--publish", "/p", "--master", "http://[::1]:1")
    assert said.code == 0, "it is signed and recorded"
    assert "rossec grant deliver" in said.err
    out = tmp_path / "p.grant"
    robot.unlocked("grant", "sign", "/robot", "--publish", "/p", "--out", str(out))
    away.rename(robot.node("/robot"))
    assert "/robot holds grant" in robot("grant", "install", str(out)).out
    out.write_bytes(out.read_bytes()[:-1] + b"\0")
    assert robot("grant", "install", str(out)).code == 1


def test_an_unusable_file_lifetime_or_name_is_found_before_signing(robot: Shell, tmp_path: Path) -> None:
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
    refused(said, "'robot' is not an absolute ROS name", "for example /robot:")
    assert robot("grant", "list").out == ""
    assert taken.read_text() == "mine"


def test_each_preset_says_what_it_hides_and_discloses(robot: Shell) -> None:
    lines = robot("grant", "presets").out.splitlines()
    assert lines[::3] == list(PRESETS)
    assert all(line.startswith("  hides ") for line in lines[1::3])
    assert all(line.startswith("  still discloses ") for line in lines[2::3])


def test_a_mistyped_node_is_answered_with_the_near_one(robot: Shell) -> None:
    said = robot.unlocked("grant", "sign", "/robt", "--publish", "/p")
    refused(said, "/robt has no valid identity here", "did you mean /robot? else first enroll it")

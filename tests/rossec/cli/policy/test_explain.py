"""`rossec explain`: transcripts."""

import json
from pathlib import Path

import numpy as np
import pytest

from rossec.cli.policy.explain import changes, subject_of
from rossec.cli.shared.context import Environment
from rossec.participant.message_types import message_type
from tests.support.commands import Shell, refused

POLICY = """rossec: 1
robot: r
identities: {heating: {node: /heating, key: "sha256:KEY"}}
types: {/pose: geometry_msgs/PoseStamped}
rules:
  - id: room
    why: Heating lowers rooms.
    who: heating
    allow: {subscribe: [/pose, /untyped]}
    filter: {/pose: {pose.position: {round: 2.0}, header.frame_id: {clear: true}}}
    when: now.getFullYear() > 2000
  - {id: when, who: heating, allow: {subscribe: [/pose]}, when: 'msg.header.frame_id == "map"'}
"""
KEY = "00" * 32


@pytest.fixture
def file(tmp_path: Path) -> str:
    path = tmp_path / "policy.yaml"
    path.write_text(POLICY.replace("KEY", KEY))
    return str(path)


@pytest.fixture
def message(tmp_path: Path) -> Path:
    path = tmp_path / "pose.yaml"
    path.write_text("{header: {frame_id: map}, pose: {position: {x: 3.3}}}")
    return path


def test_an_allowed_right_is_explained(shell: Shell, file: str, message: Path) -> None:
    said = shell("explain", "/heating", "subscribe", "/pose", "--policy", file, "--message", str(message))
    assert said.out.splitlines() == [
        "ALLOW: /heating subscribe /pose",
        "  sees where it is: exactly (pose.orientation.x is as it is)",
        "  sees how it moves: exactly (pose.orientation.x is as it is)",
        "  rule room: Heating lowers rooms. (allow subscribe /pose)",
        "  rule when (allow subscribe /pose)",
        '    only when msg.header.frame_id == "map"',
        "    only when now.getFullYear() > 2000",
        "    header.frame_id: clear",
        "    pose.position: round step 2.0",
        "    valid 7d",
        "  without room and when it would be deny, by default",
        "this message would be sent",
        "  header.frame_id: \"map\" -> ''",
        "  pose.position.x: 3.3 -> 4.0",
    ]
    assert said.err.startswith("rossec: /heating is not enrolled here: rules that pin its key")


def test_a_withheld_message_is_explained(shell: Shell, file: str, tmp_path: Path) -> None:
    kind = message_type("geometry_msgs/PoseStamped")
    raw = tmp_path / "pose.bin"
    raw.write_bytes(bytes(kind.serialize(kind.create())))
    said = shell("explain", "/heating", "subscribe", "/pose", "--policy", file, "--message", str(raw))
    assert 'withheld: the condition is not true: msg.header.frame_id == "map"' in said.out


def test_an_explanation_is_printed_as_json(shell: Shell, file: str, message: Path) -> None:
    arguments = ("explain", "/heating", "subscribe", "/pose", "--policy", file, "--json")
    plain = json.loads(shell(*arguments).out)
    assert (plain["decision"], plain["rules"]) == ("allow", ["room", "when"])
    tried = json.loads(shell(*arguments, "--message", str(message)).out)["message"]
    assert tried["sent"] is True
    assert any(line.startswith("pose.position.x: 3.3 -> 4.0") for line in tried["changed"])


def test_an_enrolled_node_has_its_own_key(shell: Shell, file: str) -> None:
    shell.enroll("/heating")
    said = shell("explain", "/heating", "subscribe", "/pose", "--policy", file)
    assert said.err == ""
    assert "near miss: rule room is for another key of heating, not /heating" in said.out
    said = shell("explain", "/other", "publish", "/pose", "--policy", file)
    assert said.out.startswith("DENY: /other publish /pose\n  no rule matches")
    assert "/other is not enrolled here" in said.err


def test_a_wrong_call_is_refused(shell: Shell, file: str, message: Path) -> None:
    ask = ("--policy", file)
    refused(shell("explain", "/heating", "subscibe", "/pose", *ask), "'subscibe'", "'subscribe'")
    refused(shell("explain", "heating", "subscribe", "/pose", *ask), "heating")
    said = shell("explain", "/heating", "subscribe", "/untyped", *ask, "--message", str(message))
    assert (said.code, "does not say the type of /untyped" in said.err) == (1, True)


def test_arrays_that_fill_lines_are_shown_by_their_first() -> None:
    kind = message_type("sensor_msgs/LaserScan")
    scans = [kind.create(ranges=np.full(50, value, np.float32)) for value in (1.23456, 2.5)]
    before, after = (bytes(kind.serialize(scan)) for scan in scans)
    (line,) = changes("sensor_msgs/LaserScan", before, after)
    assert line.startswith("ranges: [1.23456")


def test_changes_are_shortened() -> None:
    kind = message_type("std_msgs/String")
    before, after = (bytes(kind.serialize(kind.create(data=text))) for text in ("a" * 99, ""))
    (line,) = changes("std_msgs/String", before, after)
    assert line.startswith('data: "' + "a" * 40)
    assert "..." in line


def test_an_anonymous_node_is_its_certified_name(shell: Shell, file: str) -> None:
    shell("node", "request", "/heating")
    request = str(shell.node("/heating") / "node.csr")
    assert shell.unlocked("ca", "sign", request, "--yes", "--anonymous").code == 0
    subject = subject_of(Environment(shell.environ), "/heating_17")
    assert subject.name == "/heating"
    assert subject.key != bytes(32)


LEVELS = """rossec: 1
robot: r
types: {/odom: nav_msgs/Odometry, /door: std_msgs/Bool}
vocabulary: {/door: {data: home}}
rules:
  - {id: room, who: /heating, allow: {subscribe: [/odom]}, see: {position: room}}
  - {id: door, who: /heating, allow: {subscribe: [/door]}, see: {home: no}}
  - {id: drive, who: /heating, allow: {publish: [/odom]}}
"""


def test_levels_are_said_first_and_the_fields_after(shell: Shell, tmp_path: Path) -> None:
    path = tmp_path / "levels.yaml"
    path.write_text(LEVELS)
    ask = ("explain", "/heating", "subscribe")
    lines = shell(*ask, "/odom", "--policy", str(path)).out.splitlines()
    assert lines[:3] == [
        "ALLOW: /heating subscribe /odom",
        "  sees where it is: the room (no finer than 4 m, one message at the start of each 30 s)",
        "  sees how it moves: only by where it is",
    ]
    assert "    pose.pose.position: round hysteresis 2.0 step 4.0" in lines
    shown = json.loads(shell(*ask, "/odom", "--policy", str(path), "--json").out)["sees"]
    assert shown == {"position": "room", "movement": "rough"}
    door = shell(*ask, "/door", "--policy", str(path)).out
    assert "  sees nothing of the state of the home\n" in door
    published = shell("explain", "/heating", "publish", "/odom", "--policy", str(path)).out
    assert "sees" not in published


DENIES = """rossec: 1
robot: r
rules:
  - {id: no, who: /heating, deny: {subscribe: [/pose], param-set: [/safety]}}
"""


def test_a_grant_in_force_is_said_beside_what_the_policy_says(shell: Shell, tmp_path: Path) -> None:
    policy = tmp_path / "policy.yaml"
    policy.write_text(DENIES)
    shell.enroll("/heating")
    ask = ("explain", "/heating", "subscribe", "/pose", "--policy", str(policy))
    assert "in force" not in shell(*ask).out
    sign = ("grant", "sign", "/heating", "--subscribe", "/pose", "--param-set", "/safety/speed")
    assert shell.unlocked(*sign).code == 0
    said = shell(*ask).out
    assert said.startswith(
        "IN FORCE: /heating subscribe /pose, by a grant; the policy says\nDENY: /heating subscribe /pose\n"
    )
    assert "gives subscribe /pose until" in said
    assert "the policy does not allow what these grants still give" in said
    (one,) = json.loads(shell(*ask, "--json").out)["in_force"]
    of_tree = shell("explain", "/heating", "param-set", "/safety", "--policy", str(policy)).out
    assert "gives param-set /safety/speed, a part of it, until" in of_tree
    assert "revoked" in shell.unlocked("grant", "revoke", one["grant"][:8]).out
    assert "in force" not in shell(*ask).out


def test_without_a_policy_grants_signed_by_hand_are_what_counts(shell: Shell) -> None:
    shell.enroll("/heating")
    ask = ("explain", "/heating", "subscribe", "/pose")
    said = shell(*ask)
    assert (said.code, said.out) == (
        0,
        (
            "DENY: /heating subscribe /pose\n"
            "  there is no policy, only grants signed by hand\n"
            "  rossec grant sign /heating --subscribe /pose would change it\n"
        ),
    )
    assert shell.unlocked("grant", "sign", "/heating", "--subscribe", "/pose").code == 0
    said = shell(*ask)
    assert said.out.startswith("IN FORCE: /heating subscribe /pose\n  in force: grant ")
    found = json.loads(shell(*ask, "--json").out)
    assert (found["decision"], len(found["in_force"])) == ("none", 1)
    said = shell("explain", "/heatin", "subscribe", "/pose")
    assert "nobody named /heatin is enrolled here (did you mean '/heating'?)" in said.err


def test_where_there_is_no_authority_that_is_the_mistake(empty: Shell) -> None:
    refused(empty("explain", "/a", "subscribe", "/b"), "there is no authority in", "ca init")


def test_a_node_that_nobody_knows_is_said_to_be_unknown(shell: Shell, file: str) -> None:
    said = shell("explain", "/heatin", "subscribe", "/pose", "--policy", file)
    assert "nobody named /heatin is known" in said.err
    assert "did you mean '/heating'?" in said.err
    assert "nobody" not in shell("explain", "/heating", "publish", "/x", "--policy", file).err

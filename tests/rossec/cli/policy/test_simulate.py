"""`rossec simulate`: old against new on a real bag."""

import json
from pathlib import Path
from types import SimpleNamespace

import pytest
from rosbags.rosbag1 import Writer

from rossec.cli.policy import simulate as module
from rossec.participant.message_types import message_type
from tests.support.commands import Shell, refused

TYPES = "types: {/pose: geometry_msgs/PoseStamped}\n"
OLD = (
    "rossec: 1\nrobot: r\n"
    + TYPES
    + """rules:
  - {id: all, who: /x, allow: {subscribe: [/pose, /text]}}
"""
)
NEW = (
    "rossec: 1\nrobot: r\n"
    + TYPES
    + """rules:
  - id: room
    who: /x
    allow: {subscribe: [/pose]}
    filter: {pose.position: {round: 2.0}}
    when: 'msg.header.frame_id == "map"'
  - {id: no, who: /x, deny: {subscribe: [/text]}, why: private}
"""
)


@pytest.fixture
def bag(tmp_path: Path) -> Path:
    path = tmp_path / "walk.bag"
    pose, text = message_type("geometry_msgs/PoseStamped"), message_type("std_msgs/String")
    with Writer(path) as writer:
        poses = writer.add_connection(
            "/pose", "geometry_msgs/msg/PoseStamped", msgdef=pose.definition, md5sum=pose.md5sum
        )
        texts = writer.add_connection(
            "/text", "std_msgs/msg/String", msgdef=text.definition, md5sum=text.md5sum
        )
        for n in range(4):
            message = pose.create()
            message.header.frame_id = "map" if n % 2 else "elsewhere"
            message.pose.position.x = 3.3
            writer.write(poses, n * 10**9, bytes(pose.serialize(message)))
        writer.write(texts, 5 * 10**9, bytes(text.serialize(text.create(data="secret"))))
    return path


@pytest.fixture
def options(tmp_path: Path, bag: Path) -> tuple[str, ...]:
    (tmp_path / "old.yaml").write_text(OLD)
    (tmp_path / "new.yaml").write_text(NEW)
    return ("--policy", str(tmp_path / "new.yaml"), "--old", str(tmp_path / "old.yaml"), "--bag", str(bag))


def test_messages_are_counted_before_and_after(shell: Shell, options: tuple[str, ...]) -> None:
    assert shell("simulate", *options).out.splitlines() == [
        "/pose -> /x: 4 of 4 admitted before, 2 after",
        '  withheld after: the condition is not true: msg.header.frame_id == "map"',
        "  a message after:",
        "    pose.position.x: 3.3 -> 4.0",
        "/text -> /x: 1 of 1 admitted before, 0 after",
        "  withheld after: deny: rule no: private",
    ]


def test_another_receiver_is_counted_as_json(shell: Shell, options: tuple[str, ...]) -> None:
    rows = json.loads(shell("simulate", *options, "--node", "/y", "--json").out)
    assert [(row["topic"], row["receiver"], row["old"]["withheld"]) for row in rows] == [
        ("/pose", "/y", 4),
        ("/text", "/y", 1),
    ]
    assert rows[0]["new"]["reason"] == "deny: no rule matches"


def test_the_policy_in_force_is_compared(shell: Shell, options: tuple[str, ...]) -> None:
    plain = (*options[:2], *options[4:])
    (shell.root / "ca").mkdir(exist_ok=True)
    (shell.root / "ca" / "policy.yaml").write_text("rossec: 1\nrobot: r\nrules: []\n")
    assert "/pose -> /x: 0 of 4 admitted before, 2 after" in shell("simulate", *plain).out


def test_an_invalid_bag_is_refused(shell: Shell, options: tuple[str, ...], tmp_path: Path) -> None:
    bad = tmp_path / "bad.bag"
    bad.write_text("no bag")
    refused(
        shell("simulate", *options[:4], "--bag", str(bad)), "is not a complete ROS 1 bag", "rosbag record"
    )


def test_a_damaged_bag_is_refused(shell: Shell, options: tuple[str, ...], bag: Path) -> None:
    """What the reader of bags raises then is its own; each of them is said, none is shown."""
    whole, bad = bag.read_bytes(), bag.with_name("bad.bag")
    refusals = set()
    for place in range(13, len(whole), len(whole) // 300):
        bad.write_bytes(whole[:place] + bytes([whole[place] ^ 0xFF]) + whole[place + 1 :])
        said = shell("simulate", *options[:4], "--bag", str(bad))
        if said.code:
            refused(said, "bad.bag is not a complete ROS 1 bag: ", "see: rosbag record")
            refusals.add(said.err)
    assert len(refusals) > 3


def test_without_a_policy_in_force(shell: Shell, options: tuple[str, ...]) -> None:
    said = shell("simulate", *options[:2], *options[4:])
    assert said.code == 0
    assert "no policy is in force here" in said.err
    assert "/pose -> /x: 0 of 4 admitted before, 2 after" in said.out


def test_an_empty_bag_has_no_rows(shell: Shell, options: tuple[str, ...], tmp_path: Path) -> None:
    empty = tmp_path / "empty.bag"
    with Writer(empty):
        pass
    said = shell("simulate", *options[:4], "--bag", str(empty))
    assert "holds nothing" in said.out, said


def test_a_bag_is_bounded(shell: Shell, options: tuple[str, ...], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "MAX_MESSAGES", 2)
    said = shell("simulate", *options)
    assert "only the first 2 messages" in said.err
    assert "2 of 2 admitted before" in said.out


def test_a_message_of_unknown_layout_is_not_tried(
    shell: Shell, options: tuple[str, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "_layout", lambda _: None)
    assert "holds nothing" in shell("simulate", *options).out


def test_a_connection_without_a_good_definition_is_left_out(capsys: pytest.CaptureFixture[str]) -> None:
    connection = SimpleNamespace(msgtype="a/msg/B", topic="/a", msgdef="broken")
    assert module._layout(connection) is None
    assert "/a (a/B) is left out" in capsys.readouterr().err


def test_a_type_only_the_bag_knows_is_counted_but_not_shown() -> None:
    assert module._example("a/B", b"", b"x") == ["a type not known here: changed, but not shown"]

from pathlib import Path

import pytest

from ca.store.record import Store
from grants.model import Right
from rossec.cli.completion import values
from rossec.cli.completion.sources import RIGHTS, Sources
from rossec.participant.message_types import type_names
from tests.support.commands import Shell

POLICY = """
rossec: 1
robot: /robot1/camera # /not/this
rules:
  - { subscribe: /scan, by: "/rviz" }
  - subscribe: [/a/b, /pattern/*/x, /tree/**, std_msgs/String, $(id), http://host/x]
"""


def sources(shell: Shell, **variables: str) -> Sources:
    return Sources(shell.root, variables)


def test_nodes_are_those_with_a_directory(shell: Shell) -> None:
    assert shell("node", "request", "/robot1/camera").code == 0
    (shell.root / "nodes" / "$(id)").mkdir()
    assert sorted(map(str, sources(shell).own_nodes())) == ["/$(id)", "/robot1/camera"]


def test_the_record_gives_what_is_valid_now(shell: Shell) -> None:
    shell.enroll("/robot")
    shell.enroll("/old")
    granted = shell.unlocked("grant", "sign", "/robot", "--publish", "/x").out.split()[1]
    ended = shell.unlocked("grant", "sign", "/robot", "--publish", "/y").out.split()[1]
    shell.unlocked("grant", "revoke", ended)
    shell.unlocked("ca", "revoke", "/old")
    found = sources(shell)
    assert set(found.recorded("node")) == {"/ca", "/robot"}
    assert list(found.recorded("grant")) == [granted[:8]]
    assert granted[:8] in set(found.held_grants())


@pytest.mark.parametrize("kind", ["domain", "grant request", "invitation", "phone", "request", "thing"])
def test_every_kind_of_the_record_can_be_asked(shell: Shell, kind: str) -> None:
    assert list(sources(shell).recorded(kind)) == []


def test_requests_that_wait_are_offered(shell: Shell) -> None:
    store = Store.open(shell.root / "ca" / "ca.db")
    with store.transaction() as db:
        db.execute(
            "INSERT INTO csr VALUES (?, '/x', x'00', x'00', 'file', 0, 'pending', '', 0, 0, 0)",
            (bytes.fromhex("00112233445566"),),
        )
    assert list(sources(shell).recorded("request")) == ["00112233"]  # also while it is open
    store.close()


def test_reading_leaves_nothing_behind(shell: Shell) -> None:
    before = sorted(path.name for path in (shell.root / "ca").iterdir())
    assert list(sources(shell).recorded("node")) == ["/ca"]
    assert sorted(path.name for path in (shell.root / "ca").iterdir()) == before


def test_no_record_and_a_damaged_one_give_nothing(shell: Shell) -> None:
    record = shell.root / "ca" / "ca.db"
    record.write_bytes(b"garbage" * 1000)
    assert list(sources(shell).recorded("node")) == []
    record.unlink()
    assert list(sources(shell).recorded("node")) == []
    assert list(sources(shell).written()) == []


def test_what_others_could_have_written_gives_nothing(shell: Shell) -> None:
    (shell.root / "ca" / "policy.yaml").write_text(POLICY)
    (shell.root / "ca" / "policy.yaml").chmod(0o666)
    (shell.root / "ca" / "ca.db").chmod(0o666)
    assert list(sources(shell).recorded("node")) == []
    assert list(sources(shell).written()) == []


def test_the_policy_gives_names_and_no_patterns(shell: Shell) -> None:
    (shell.root / "ca" / "policy.yaml").write_text(POLICY)
    assert list(sources(shell).written()) == ["/robot1/camera", "/scan", "/rviz", "/a/b"]


def test_the_last_look_counts_for_its_master(shell: Shell) -> None:
    values.keep(shell.root, "http://x:1", {values.TOPIC: ["/scan"]})
    assert list(sources(shell, ROS_MASTER_URI="http://x:1").seen(values.TOPIC)) == ["/scan"]
    assert list(sources(shell).seen(values.TOPIC)) == []


def test_types_are_those_of_ros_packages(shell: Shell, tmp_path: Path) -> None:
    (tmp_path / "ws" / "shop_msgs" / "msg").mkdir(parents=True)
    (tmp_path / "ws" / "shop_msgs" / "msg" / "Order.msg").write_text("")
    found = sources(shell, ROS_PACKAGE_PATH=str(tmp_path / "ws"))
    assert "shop_msgs/Order" in set(found.types("msg"))
    assert "shop_msgs/Order" not in set(found.types("srv"))


def test_the_types_that_rosbags_knows_are_offered(shell: Shell) -> None:
    known = {name for name in type_names() if not name.startswith("builtin_interfaces/")}
    assert len(known & {str(name) for name in sources(shell).known_types()}) > 150


def test_rights_are_those_of_a_grant(shell: Shell) -> None:
    assert sorted(right.label for right in Right) == sorted(RIGHTS)
    assert list(sources(shell).rights()) == list(RIGHTS)

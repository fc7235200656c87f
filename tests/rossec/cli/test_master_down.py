"""Every command that asks the master says what to do when none runs: start it."""

import pytest

from tests.support.commands import Said, Shell

ASKS = (
    "topic list",
    "topic info /scan",
    "topic type /scan",
    "topic find std_msgs/String",
    "topic hz /scan",
    "topic bw /scan",
    "topic echo /scan",
    "topic echo /scan std_msgs/String",
    "topic pub /scan std_msgs/String data:",
    "node list",
    "node info /robot",
    "service list",
    "service info /reset",
    "service type /reset",
    "service call /reset --type std_srvs/Trigger",
    "param list",
    "param get /x",
    "param set /x 1",
    "param delete /x",
    "graph",
)
DELIVERS = ("ca publish", "ca refresh", "grant deliver")
ADMINISTERS = ("master status", "master stop", "federation status")


@pytest.fixture
def down(shell: Shell) -> Shell:
    shell.enroll("/robot")
    shell.environ["ROS_MASTER_URI"] = "http://127.0.0.1:1"
    return shell


def says(said: Said, start: str) -> None:
    *_, error, hint = said.err.splitlines()
    assert error.startswith("rossec: error: ")
    assert hint.startswith("rossec: hint: ")
    assert start in hint
    assert "Errno" not in said.err


def test_a_command_that_asks_the_master_says_how_to_start_it(down: Shell) -> None:
    for words in ASKS:
        said = down(*words.split(), "--as", "/robot")
        assert said.code == 1, words
        assert "cannot connect to 127.0.0.1 port 1: connection refused" in said.err
        says(said, "start it: rossec master; or set ROS_MASTER_URI")


def test_so_does_one_that_learns_from_its_graph(down: Shell) -> None:
    said = down("policy", "learn", "--from-graph", "/robot")
    assert said.code == 1
    says(said, "start it: rossec master")


def test_a_command_that_delivers_says_it_too(down: Shell) -> None:
    assert down.unlocked("grant", "sign", "/ca", "--publish", "/x").code == 0
    for words in DELIVERS:
        command = down if words.endswith(("publish", "deliver")) else down.unlocked
        said = command(*words.split())
        assert said.code == 3, words
        says(said, "start it: rossec master")
    said = down.unlocked("ca", "revoke", "/robot")
    assert said.code == 3
    says(said, "start it: rossec master")


def test_one_for_its_administrator_says_what_else_it_takes(down: Shell) -> None:
    said = down("master", "status")
    assert (said.code, "there is no /master in" in said.err) == (1, True)
    down.enroll("/master")
    for words in ADMINISTERS:
        said = down(*words.split())
        assert said.code == 1, words
        assert "rossec master --admin" in said.err

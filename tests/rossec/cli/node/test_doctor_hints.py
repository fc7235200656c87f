"""What `rossec doctor` says of a whole machine, and commands that can be typed as they stand."""

import json
import shlex

from tests.support.commands import Shell, refused


def test_a_join_that_was_not_finished_is_said_and_no_failure(shell: Shell) -> None:
    shell.enroll("/robot")
    assert shell.unlocked("grant", "sign", "/robot", "--publish", "/p").code == 0
    assert shell("node", "request", "/third").code == 0
    said = shell("doctor", "--offline")
    assert said.code == 0, said
    assert "/third is not enrolled yet: rossec node join again, or remove" in said.out
    assert json.loads(shell("doctor", "--offline", "--json").out)["unfinished"] == ["/third"]
    refused(shell("doctor", "--offline", "/third"), "checks failed")
    assert "or go on with an invitation: rossec node join" in shell("doctor", "/third").out


def test_what_is_said_once_is_counted_once(shell: Shell) -> None:
    for name in ("/a", "/b", "/c"):
        shell.enroll(name)
    shell.environ["ROS_IP"] = "192.0.2.7"
    for name in ("/a", "/b", "/c"):
        assert shell.unlocked("grant", "sign", name, "--publish", "/p").code == 0
    refused(shell("doctor", "--offline"), "3 of 12 checks failed, for one cause", "see above")


def test_the_command_for_a_node_without_grants_can_be_typed(shell: Shell) -> None:
    shell.enroll("/near")
    shell.enroll("/rviz", "--anonymous")
    hints = [line for line in shell("doctor", "--offline").out.splitlines() if "grant sign" in line]
    assert len(hints) == 2
    for hint in hints:
        command = hint.partition("rossec ")[2].partition(";")[0]
        assert shell.unlocked(*shlex.split(command)).code == 0, command
    assert "no grants" not in shell("doctor", "--offline").out

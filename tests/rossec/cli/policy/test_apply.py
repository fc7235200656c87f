"""`rossec policy apply`: the difference is shown, and made true; applying twice changes nothing."""

import asyncio
import io
import json
import time
from dataclasses import replace

import pytest

from grants import document
from grants.model import Right
from rossec.authority.home import AuthorityHome
from rossec.home import NodeHome
from rossec.master.server.server import master_of
from rossec.node import Node
from tests.support.commands import Said, Shell, refused

TEXT = "std_msgs/String"
NOWHERE = ("--master", "http://127.0.0.1:1/")
POLICY = """rossec: 1
robot: robbie
types: {/pose: geometry_msgs/PoseStamped}
rules:
  - {id: view, who: /viewer, allow: {subscribe: [/pose]}}
  - {id: drive, who: /robot, allow: {publish: [/pose, /odom]}}
  - {id: look, who: "*", allow: {graph: ["/**"]}}
  - {id: lift, who: /robot, prompt: {call: [/lift]}}
  - {id: shut, who: "*", deny: {subscribe: ["/camera/**"]}, why: private}
"""
NARROWER = POLICY.replace(
    "{subscribe: [/pose]}}", "{subscribe: [/pose]}, filter: {pose.position: {round: 2.0}}}"
).replace(", /odom", "")
LIFT = "? /robot: call /lift waits for a request and a person (rule lift, line 8)"


@pytest.fixture
def site(shell: Shell) -> Shell:
    for name in ("/viewer", "/robot"):
        shell.enroll(name)
    write(shell, POLICY)
    return shell


def write(shell: Shell, text: str) -> None:
    (shell.root / "ca" / "policy.yaml").write_text(text)


def apply(shell: Shell, *options: str) -> Said:
    return shell.unlocked("policy", "apply", *options)


def lines(said: Said) -> list[str]:
    """What was said of the difference, without the end of the first grant."""
    return [line for line in said.out.splitlines() if not line.startswith("the first grant")]


def held(shell: Shell, name: str) -> list[tuple[Right, str]]:
    home = NodeHome.of(shell.root, name)
    grants = [document.peek(data) for data in home.grants()]
    return sorted((item.rights, item.pattern) for grant in grants for item in grant.permissions)


def test_the_difference_is_shown_and_nothing_done(site: Shell) -> None:
    said = site("policy", "apply", "--dry-run")  # without the passphrase
    assert (said.code, said.err) == (0, "")
    assert lines(said) == [
        "+ /robot: publish /pose, valid 7d (rule drive, line 6)",
        "+ /robot: publish /odom, valid 7d (rule drive, line 6)",
        "+ /robot, /viewer: graph /**, valid 7d (rule look, line 7)",
        "+ /viewer: subscribe /pose, valid 7d (rule view, line 5)",
        LIFT,
    ]
    assert said.out.splitlines()[-1].startswith("the first grant of the policy ends 20")
    assert AuthorityHome.at(site.root).store().grants() == []


def test_leaks_are_remarked_and_refuse_nothing(site: Shell) -> None:
    write(site, NARROWER)
    said = site("policy", "apply", "--dry-run")
    assert said.code == 0
    assert said.err == (
        "rossec: this policy may give away more than it says, 6 remarks: rossec policy lint\n"
    )
    other = site.root / "other policy.yaml"
    other.write_text(NARROWER)
    said = site("policy", "apply", "--dry-run", "--policy", str(other))
    assert said.err.endswith(f"rossec policy lint '{other}'\n")


def test_the_policy_is_put_in_force_and_twice_changes_nothing(site: Shell) -> None:
    said = apply(site, "--yes")
    assert (said.code, said.err) == (0, "")
    assert lines(said)[-1] == "signed: 4"
    assert held(site, "/robot") == [(Right.PUBLISH, "/odom"), (Right.PUBLISH, "/pose"), (Right.GRAPH, "/**")]
    before = AuthorityHome.at(site.root).store()
    rows = before.grants()
    assert set(before.policy_grants().values()) == {"drive", "look", "view"}
    again = site("policy", "apply", *NOWHERE)  # asks neither yes nor the passphrase
    assert again.code == 0
    assert lines(again) == ["= 5 rights of 2 nodes as before", LIFT, "the policy is in force, nothing to do"]
    assert AuthorityHome.at(site.root).store().grants() == rows


def test_a_changed_rule_narrows_and_revokes(site: Shell) -> None:
    apply(site, "--yes")
    write(site, NARROWER)
    said = apply(site, "--yes", *NOWHERE)
    assert said.code == 3  # no master runs here: done, but not delivered
    assert "did not take the list" in said.err
    assert lines(said) == [
        "- /robot: publish /odom (no rule allows it any more)",
        (
            "~ /viewer: narrower: subscribe /pose, pose.position: round step 2.0; valid 7d"
            " (rule view, line 5); before: valid 7d"
        ),
        "= 3 rights of 2 nodes as before",
        LIFT,
        "signed: 2",
        "revoked: 2 (list 2)",
    ]
    again = apply(site, "--yes", *NOWHERE)
    assert again.code == 0
    assert "the policy is in force, nothing to do" in again.out


@pytest.mark.parametrize("answer", ["", "n\n"])
def test_without_an_answer_nothing_is_done(site: Shell, monkeypatch: pytest.MonkeyPatch, answer: str) -> None:
    monkeypatch.setattr("sys.stdin", io.StringIO(answer))
    said = apply(site)
    assert said.code == 1
    assert "sign 4 grants? [y/N]: " in said.err
    assert "nothing was done" in said.err
    assert AuthorityHome.at(site.root).store().grants() == []


def test_grants_by_hand_are_named_and_left_or_pruned(site: Shell) -> None:
    apply(site, "--yes")
    hand = ("grant", "sign", "/robot", "--subscribe", "/camera/a", "--publish", "/led")
    assert site.unlocked(*hand).code == 0
    (row,) = AuthorityHome.at(site.root).store().grants()[4:]
    named = f"subscribe /camera/a by grant {row.id.hex()[:8]}, made by hand, against the denial of"
    for options in (("--yes",), ("--dry-run",)):
        said = apply(site, *options, *NOWHERE)
        said = replace(said, err=said.err[said.err.index("rossec: error") :])
        refused(said, "1 grant made by hand allows what the policy denies", "--prune", code=4)
        assert f"! /robot: {named} rule shut, line 9" in said.out
    said = apply(site, "--yes", "--prune", *NOWHERE)
    assert (said.code, lines(said)[-1]) == (3, "revoked: 1 (list 2)")
    assert f"- /robot: {named} rule shut, line 9" in said.out
    assert apply(site, *NOWHERE).code == 0
    assert (Right.PUBLISH, "/led") in held(site, "/robot")  # what else it allowed
    store = AuthorityHome.at(site.root).store()
    assert row.id in store.revoked_entries()
    assert len(store.policy_grants()) == 4


def test_a_denied_pattern_says_why_it_is_not_granted(site: Shell) -> None:
    write(site, POLICY.replace("subscribe: [/pose]}}", 'subscribe: ["/**"]}}'))
    assert (
        "! /viewer: subscribe /** (rule view, line 5) is not granted: rule shut, line 9 denies some"
        " of it; write the rule for narrower names" in apply(site, "--dry-run").out
    )


def test_a_policy_with_mistakes_changes_nothing(site: Shell) -> None:
    write(site, POLICY.replace("publish", "publis"))
    refused(apply(site, "--yes"), "publis")
    assert AuthorityHome.at(site.root).store().grants() == []


def test_another_policy_and_one_node(site: Shell) -> None:
    other = site.root / "other.yaml"
    other.write_text(POLICY)
    (site.root / "ca" / "policy.yaml").unlink()
    refused(apply(site, "--yes"), "there is no policy")
    said = apply(site, "--yes", "--policy", str(other), "--node", "/viewer")
    assert (said.code, lines(said)[-1]) == (0, "signed: 2")
    assert held(site, "/robot") == []


def test_the_difference_for_programs(site: Shell) -> None:
    said = apply(site, "--yes", "--json")
    shown = json.loads(said.out)
    assert said.err == "rossec: signed: 4\n"
    assert (shown["sign"], shown["revoke"], len(shown["changes"])) == (4, [], 5)
    assert shown["changes"][0] == {
        "sign": "+",
        "kind": "new",
        "node": "/robot",
        "right": "publish",
        "name": "/pose",
        "restrictions": ["valid 7d"],
        "before": [],
        "rules": [{"id": "drive", "line": 6, "why": ""}],
    }


RUNNING = """rossec: 1
robot: robbie
rules:
  - {id: see, who: /viewer, allow: {subscribe: [/pose]}}
  - {id: hear, who: /viewer, allow: {subscribe: [/sound]}}
  - {id: drive, who: /robot, allow: {publish: [/pose, /sound]}}
"""


async def test_a_running_system_follows_the_policy_and_nothing_else_comes_down(shell: Shell) -> None:
    """What is no longer allowed is cut at once; what no changed rule is about is not touched."""
    for name in ("/robot", "/viewer", "/master"):
        await asyncio.to_thread(shell.enroll, name)
    write(shell, RUNNING)
    authority = AuthorityHome.at(shell.root)
    server = master_of(
        NodeHome.of(shell.root, "/master"),
        host="127.0.0.1",
        port=0,
        newest=authority.revocation_list(),
        now=int(time.time()),
    )
    await server.start()
    environ = {**shell.environ, "ROS_MASTER_URI": server.uri}
    command = ("policy", "apply", "--yes", "--master", server.uri)
    try:
        said = await asyncio.to_thread(shell.unlocked, *command)
        assert (said.code, said.out.splitlines()[-1]) == (0, "signed: 3")
        async with Node("/robot", environ=environ) as robot, Node("/viewer", environ=environ) as v:
            publishers = [await robot.publisher(name, TEXT) for name in ("/pose", "/sound")]
            heard = [await v.subscriber(name, TEXT) for name in ("/pose", "/sound")]
            async with asyncio.timeout(30):
                for publisher, subscriber in zip(publishers, heard, strict=True):
                    await publisher.wait_for_subscribers()
                    publisher.publish(publisher.create(data="before"))
                    await anext(aiter(subscriber))
            pose, sound = publishers
            kept = list(sound.links)
            write(shell, RUNNING.replace("[/pose]", "[/other]", 1))
            said = await asyncio.to_thread(shell.unlocked, *command)
            assert (said.code, said.err) == (0, "")
            assert said.out.splitlines()[-3:] == [
                "revoked: 1 (list 2)",
                "the master has the new list",
                "signed: 1",
            ]
            async with asyncio.timeout(30):
                while pose.links:  # noqa: ASYNC110 - nothing tells
                    await asyncio.sleep(0.01)
                assert list(sound.links) == kept
                sound.publish(sound.create(data="after"))
                await anext(aiter(heard[1]))
    finally:
        await server.close()


def test_basics_are_one_line_for_all_nodes(site: Shell) -> None:
    write(site, "rossec: 1\nrobot: r\nbasics: true\nrules: []\n")
    said = apply(site, "--yes")
    assert lines(said)[0] == (
        "+ /robot, /viewer: what every ROS program needs, valid 7d (rule basics, line 3)"
    )
    assert (Right.PUBLISH, "/rosout") in held(site, "/robot")
    assert (Right.PROVIDE, "/robot/get_loggers") in held(site, "/robot")
    assert (Right.PROVIDE, "/robot/get_loggers") not in held(site, "/viewer")
    assert "nothing to do" in apply(site, "--yes").out


def test_a_policy_of_which_a_test_fails_is_not_applied(site: Shell) -> None:
    kept = "tests:\n  - {who: /viewer, sees: {/pose: {pose.position: 2.0}}}\n"
    write(site, POLICY + kept)
    said = apply(site, "--yes")
    refused(said, "/viewer sees pose.position.x of /pose finer than 2: rule view, line 5")
    assert held(site, "/viewer") == []
    write(site, NARROWER + kept)
    assert apply(site, "--yes").code == 0
    assert held(site, "/viewer") != []

"""Policies that people asked for elsewhere: programs that act for somebody, and drive."""

import struct
from pathlib import Path
from typing import Final

import pytest

from ca.keys import private_keys
from ca.keys.signing import KeySigner
from grants import document
from grants.decision import authorize
from grants.filters.layout import parse
from grants.guard import Guard, Memory
from grants.model import Draft, Grant, Right
from grants.policy.decision import Decider
from grants.policy.model import Subject
from grants.policy.wanted import drafts
from rossec.authority.policyfile import layout_of, parse_policy
from rossec.participant.message_types import message_type
from tests.support.commands import Shell, refused

OBSERVED: Final = Path(__file__).parents[3] / "vectors" / "observed"
AGENT: Final = Subject("/agent", b"a" * 32)
NOW: Final = 1_795_000_000


def test_an_agent_may_look_and_drive_slowly(shell: Shell) -> None:
    said = shell("policy", "check", str(OBSERVED / "agent_looks_and_drives_slowly.yaml"))
    assert said.code == 0, said
    assert "is right; rules: 3, tests that hold: 2" in said.out


def test_what_an_agent_writes_can_be_clamped(shell: Shell) -> None:
    said = shell("policy", "check", str(OBSERVED / "agent_drives_clamped.yaml"))
    assert said.code == 0, said


def test_too_fast_arrives_as_the_limit() -> None:
    """The grant that the policy makes, in the guard of whoever receives the commands."""
    policy = parse_policy((OBSERVED / "agent_drives_clamped.yaml").read_text(), "policy.yaml")
    verdict = Decider(policy).decide(AGENT, Right.PUBLISH, "/cmd_vel")
    [draft] = drafts([verdict], domain="home", now=NOW, skew=60, serial=lambda: bytes(16))
    decision = authorize(
        [granted(draft)], Right.PUBLISH, "/cmd_vel", holder=AGENT.key, now=NOW, check=lambda *_: None
    )
    kind = message_type("geometry_msgs/Twist")
    guard = Guard(layout_of(kind.name), decision, None, lambda _: Memory())
    for wanted, told in ((0.9, 0.2), (-3.0, -0.2), (0.1, 0.1), (float("nan"), -0.2)):
        sent = kind.create()
        sent.linear.x, sent.angular.z = wanted, 7.0
        guard = Guard(parse(kind.name, kind.definition), decision, None, lambda _: Memory())
        pieces = guard(bytes(kind.serialize(sent)), NOW)
        assert pieces is not None
        assert struct.unpack("<6d", b"".join(pieces)) == (told, 0, 0, 0, 0, 7.0)


def granted(draft: Draft) -> Grant:
    return document.peek(document.sign(KeySigner(private_keys.generate()), draft))


@pytest.mark.parametrize(
    ("lines", "said"),
    [
        ("allow: {publish: [/cmd_vel]}, filter: {use: coarse-position}", "a preset or a pseudonym"),
        ("allow: {publish: [/cmd_vel]}, limit: {slot: 30}", "of what is subscribed to"),
        ("allow: {publish: [/cmd_vel]}, filter: {linear.w: {clamp: [0, 1]}}", "no field 'w'"),
        (
            "allow: {publish: [/cmd_vel]}, filter: {/odom: {linear.x: {clamp: [0, 1]}}}",
            "has no publish right on '/odom'",
        ),
        ("allow: {publish: [/cmd_vel]}, see: {movement: no}", "rule drive: nothing to see"),
    ],
)
def test_what_is_published_has_no_other_restriction(
    shell: Shell, tmp_path: Path, lines: str, said: str
) -> None:
    file = tmp_path / "policy.yaml"
    file.write_text(
        "rossec: 1\nrobot: demo\ntypes: {/cmd_vel: geometry_msgs/Twist}\n"
        f"rules: [{{id: drive, who: /agent, {lines}}}]\n"
    )
    refused(shell("policy", "check", str(file)), said)


def test_a_filter_of_a_rule_that_subscribes_leaves_what_it_publishes() -> None:
    policy = parse_policy(
        "rossec: 1\nrobot: demo\n"
        "types: {/pose: geometry_msgs/Twist, /cmd_vel: geometry_msgs/Twist}\n"
        "rules: [{id: a, who: /agent, allow: {publish: [/cmd_vel], subscribe: [/pose]},"
        " filter: {linear.x: {clamp: [0, 1]}}}]\n",
        "policy.yaml",
    )
    decider = Decider(policy)
    assert decider.decide(AGENT, Right.PUBLISH, "/cmd_vel").restrictions == ()
    assert len(decider.decide(AGENT, Right.SUBSCRIBE, "/pose").restrictions) == 1

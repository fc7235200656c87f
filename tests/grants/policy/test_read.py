"""The outline of a policy: versions, defaults, identities, types, and unique ids."""

import pytest

from grants.errors import GrantError, PolicyRefused
from grants.policy.model import DAY, Effect
from grants.policy.read import load, mistakes_in
from tests.grants.policy.policies import HEADER, HEATING_KEY, mistakes, nothing_known, policy


def test_a_valid_policy() -> None:
    read = policy()
    assert read.robot == "test-robot"
    assert [rule.id for rule in read.rules] == ["heating-room", "heating-own", "nav-full", "no-camera"]
    assert read.identities["heating"].key == HEATING_KEY
    assert read.type_of("/robot/pose") == "geometry_msgs/PoseStamped"
    defaults = read.defaults
    assert (defaults.decision, defaults.prompt_timeout) == (Effect.PROMPT, 60)
    assert read.rules[0].renew_until == 180 * DAY
    assert read.rules[0].line == 13


def test_defaults_deny() -> None:
    read = policy(HEADER + "rules: []\n")
    assert read.defaults.decision is Effect.DENY
    assert read.rules == ()
    assert (read.defaults.renew_until, read.defaults.has_lifetime) == (0, False)


@pytest.mark.parametrize(
    ("text", "message", "hint"),
    [
        ("", "a policy is a mapping", "begin with: rossec: 1"),
        ("- 1", "a policy is a mapping", "begin with: rossec: 1"),
        ("rossec: 2\nrobot: r\nrules: []", "a policy of an unknown version", "version 1"),
        ("rossec: true\nrobot: r\nrules: []", "a policy of an unknown version", "version 1"),
        ("rossec: [1]\nrobot: r\nrules: []", "a policy of an unknown version", "version 1"),
        ("rossec: 1\nrobot: r\n", "the policy has no 'rules'", "add rules: []"),
        ("robot: r\nrules: []\n", "the policy has no 'rossec'", "add rossec: 1"),
        (
            "rossec: 1\nrules: []\n",
            "the policy has no 'robot'",
            "add robot: NAME, what the policy is for: a robot, a home; reports are headed with it",
        ),
        (HEADER + "rules: 5", "a rule must be a mapping", "write key: value"),
        (
            HEADER + "rules: []\ndefaults: {decision: allow}",
            "unknown default decision: 'allow'",
            "expected one of deny, prompt",
        ),
        (HEADER + "rules: []\ndefaults: 5", "defaults must be a mapping", ""),
        (HEADER + "rules: []\nidentities: {x: {}}", "identity x has neither node nor key", "add"),
        (HEADER + "rules: []\nidentities: {x: 5}", "identity x must be a mapping", ""),
        (HEADER + "rules: []\nidentities: {/x: {node: /x}}", "'/x' cannot be the name", ""),
        (HEADER + 'rules: []\nidentities: {"*": {node: /x}}', "'*' cannot be the name", ""),
        (HEADER + "rules: []\nfilters: {x: 5}", "filter x must be a mapping", ""),
        (HEADER + "rules: []\ntypes: {/x: 5}", "the type of /x must be text", ""),
        (HEADER + "rules: []\nrobot: x", "duplicate key 'robot'", "keep one"),
    ],
)
def test_mistakes_outside_rules(text: str, message: str, hint: str) -> None:
    about = [item for item in mistakes(text) if item.message.startswith(message)]
    assert about, mistakes(text)
    assert hint in about[0].hint


def test_ids_are_unique() -> None:
    rule = "  - {id: a, who: /x, allow: {call: [/y]}}\n"
    found = mistakes(HEADER + "rules:\n" + rule + rule)
    assert [item.message for item in found] == ["duplicate rule 'a'; the first is in 4:5"]


def test_without_known_types_the_error_of_the_definition_is_used() -> None:
    text = HEADER + "rules: []\ntypes: {/x: a/B, /y: a/B}"
    with pytest.raises(PolicyRefused) as caught:
        load(text, nothing_known)
    first, _ = mistakes_in(caught.value)
    assert (first.message, first.hint) == ("unknown message type 'a/B'", "write package/Type")
    assert first.file == "policy.yaml"


def test_an_invalid_definition_is_a_mistake() -> None:
    with pytest.raises(PolicyRefused, match="not a field"):
        load(HEADER + "rules: []\ntypes: {/x: a/B}", lambda _: "broken")


def test_all_mistakes_are_reported_at_once() -> None:
    text = "rossec: 3\nrobt: r\ntypes: {x: a/B}\nrules:\n  - {id: a, who: b, alow: {}}\n"
    assert len(mistakes(text)) == 7


def test_other_errors_carry_no_mistakes() -> None:
    assert mistakes_in(GrantError("x")) == ()

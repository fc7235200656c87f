"""The effect of a verdict on a message."""

import struct

import pytest

from grants.filters.layout import parse
from grants.model import Right
from grants.policy import privacy as module
from grants.policy.privacy import Trial
from tests.grants.policy.policies import HEADER, decide, definition, node, rules

STRING = parse("std_msgs/String", definition("std_msgs/String"))
POSE = parse("geometry_msgs/PoseStamped", definition("geometry_msgs/PoseStamped"))
HELLO = struct.pack("<I", 5) + b"hello"
LINES = (
    "{id: a, who: /x, allow: {subscribe: /s}, filter: {data: {truncate: 2}}}",
    "{id: b, who: /x, allow: {subscribe: /s}, when: 'msg.data.startsWith(\"h\")'}",
    "{id: c, who: /x, allow: {subscribe: /s}, when: 'now.getFullYear() < 2030'}",
    "{id: d, who: /y, deny: {subscribe: /s}, why: no}",
)


def trial(who: str = "/x", layout: object = STRING) -> Trial:
    of = rules(*LINES, head=HEADER + "types: {/s: std_msgs/String}\n")
    return Trial(layout, decide(of, node(who), Right.SUBSCRIBE, "/s"))  # type: ignore[arg-type]


def test_a_trial_filters_as_the_guard() -> None:
    assert trial()(HELLO, 0).message == struct.pack("<I", 2) + b"he"


@pytest.mark.parametrize(
    ("who", "message", "now", "reason"),
    [
        ("/x", struct.pack("<I", 1) + b"j", 0, 'the condition is not true: msg.data.startsWith("h")'),
        ("/x", HELLO, 1 << 34, "the condition is not true: now.getFullYear() < 2030"),
        ("/x", HELLO + b"tail", 0, "std_msgs/String"),
        ("/y", HELLO, 0, "deny: rule d: no"),
        ("/z", HELLO, 0, "deny: no rule matches"),
    ],
)
def test_a_withheld_message_has_a_reason(who: str, message: bytes, now: int, reason: str) -> None:
    outcome = trial(who)(message, now)
    assert outcome.message is None
    assert reason in outcome.reason


def test_a_trial_applies_the_rate() -> None:
    of = rules("{id: a, who: /x, allow: {subscribe: /s}, limit: {rate: 0.5}}")
    tried = Trial(STRING, decide(of, node("/x"), Right.SUBSCRIBE, "/s"))
    passed = [tried(HELLO, now) for now in range(5)]
    assert [outcome.message is not None for outcome in passed] == [True, False, True, False, True]
    assert passed[1].reason == "more than 0.5 messages a second"


def test_a_trial_applies_the_slots() -> None:
    line = "{id: a, who: /x, allow: {subscribe: /s}, filter: {use: presence-only}}"
    of = rules(line, head=HEADER + "types: {/s: std_msgs/String}\n")
    tried = Trial(STRING, decide(of, node("/x"), Right.SUBSCRIBE, "/s"))
    passed = [tried(HELLO, now) for now in (30, 60, 61)]
    assert [each.message for each in passed] == [None, bytes(4), None]
    assert passed[0].reason == "not the one message at the start of each 60 s"


def test_pseudonyms_use_placeholder_keys() -> None:
    of = rules(
        "{id: a, who: /x, allow: {subscribe: /s}, filter: {data: {hash: {key: k, length: 8}}}}",
        head=HEADER + "types: {/s: std_msgs/String}\n",
    )
    message = Trial(STRING, decide(of, node("/x"), Right.SUBSCRIBE, "/s"))(HELLO, 0).message
    assert message is not None
    assert message[:4] == struct.pack("<I", 8)


def test_another_type_is_withheld() -> None:
    outcome = trial(layout=POSE)(HELLO, 0)
    assert outcome.message is None
    assert "of type std_msgs/String, these are geometry_msgs/PoseStamped" in outcome.reason


def test_a_withheld_message_without_failed_condition(monkeypatch: pytest.MonkeyPatch) -> None:
    tried = trial()
    monkeypatch.setattr(module, "compile_condition", lambda *_: lambda *_: True)
    assert tried(struct.pack("<I", 1) + b"j", 0).reason == "not admitted"

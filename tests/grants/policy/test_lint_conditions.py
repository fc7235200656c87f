"""Conditions that tell what a filter hides."""

import pytest

from grants.conditions.syntax import fields_read
from tests.grants.policy.lint_cases import codes, findings, messages, text_of
from tests.grants.policy.lint_leaks import COARSE, CONDITIONS, Leak, also, filtered


@pytest.mark.parametrize("leak", CONDITIONS, ids=lambda leak: leak.name)
def test_the_condition_is_to_be_removed(leak: Leak) -> None:
    for finding in findings(text_of(*leak.rules)):
        assert finding.code == "condition-tells"
        [change] = finding.suggestions
        assert "msg." in change.without


@pytest.mark.parametrize(
    ("text", "fields"),
    [
        ("now.getHours() > 5", []),
        ("msg.a.b == 1 && !(msg.a.b > 2 || -msg.c < 3)", ["a.b", "c"]),
        ("msg.a in [1, msg.b]", ["a", "b"]),
        ('msg.a.startsWith("x") && now < timestamp("2026-11-20T18:00:00Z")', ["a"]),
        ("msg.a.contains(msg.b)", ["a", "b"]),
    ],
)
def test_the_fields_of_a_condition(text: str, fields: list[str]) -> None:
    assert fields_read(text) == fields


def test_it_says_how_much_the_filter_leaves() -> None:
    condition = ", when: 'msg.pose.position.x < 5.0'"
    [message] = messages(COARSE + condition)
    assert "/x sees pose.position.x of /pose coarsely, but a condition on it tells" in message
    assert codes(filtered("/pose", "header: {clear: true}", condition)) == []


def test_of_one_condition_each_field_is_named() -> None:
    found = messages(COARSE + ", when: 'msg.pose.position.x < msg.pose.position.y'")
    assert len(found) == 2


def test_a_condition_for_another_node_is_no_oracle() -> None:
    other = also("/pose", ", when: 'msg.pose.position.x < 5.0'").replace("/x", "/y")
    assert codes(COARSE, other) == []

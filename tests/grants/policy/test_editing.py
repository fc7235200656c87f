"""Adding rules leaves everything else as it was written."""

from dataclasses import replace

import pytest

from grants.errors import PolicyRefused
from grants.policy import learn
from grants.policy.learn import NewRule, add_rules, empty, free_id
from tests.grants.policy.policies import policy

TEXT = """# The flat.
rossec: 1
robot: r   # an old one
types:
  /scan: sensor_msgs/LaserScan

# What holds.
rules:
  - id: "one"   # the first
    who: /a
    allow: {subscribe: /scan}   # one name, no list
"""


def rule(**changes: object) -> NewRule:
    usual: dict[str, object] = {
        "id": "two",
        "why": "because",
        "who": "/b",
        "effect": "allow",
        "rights": {"publish": ["/c"]},
        "types": {"/c": "std_msgs/String"},
    }
    return NewRule(**{**usual, **changes})  # type: ignore[arg-type]


def test_comments_and_quotes_stay() -> None:
    text = add_rules(TEXT, [rule()])
    for line in ("# The flat.", "robot: r   # an old one", "# What holds.", '- id: "one"'):
        assert line in text
    assert text.endswith("  - id: two\n    why: because\n    who: /b\n    allow:\n      publish: [/c]\n")
    read = policy(text)
    assert [item.id for item in read.rules] == ["one", "two"]
    assert read.types == {"/c": "std_msgs/String", "/scan": "sensor_msgs/LaserScan"}


def test_an_existing_rule_is_extended() -> None:
    more = rule(id="one", rights={"subscribe": ["/scan", "/d"], "call": ["/e"]}, types={})
    read = policy(add_rules(TEXT, [more, more]))
    assert [(c.right.label, c.pattern) for c in read.rules[0].clauses] == [
        ("subscribe", "/scan"),
        ("subscribe", "/d"),
        ("call", "/e"),
    ]


def test_an_existing_type_is_not_changed() -> None:
    text = add_rules(TEXT, [rule(types={"/scan": "std_msgs/String"})])
    assert policy(text).types == {"/scan": "sensor_msgs/LaserScan"}


def test_a_filter_is_used_by_name() -> None:
    text = TEXT + "filters: {none: {ranges: {drop: true}}}\n"
    text = add_rules(text, [rule(rights={"subscribe": ["/scan"]}, filter="none", types={})])
    (clause,) = policy(text).rules[1].clauses
    assert clause.restriction is not None


def test_rules_are_added_to_an_empty_policy() -> None:
    start = empty("robbie")
    assert policy(start).robot == "robbie"
    assert policy(add_rules(start, [rule()])).types == {"/c": "std_msgs/String"}
    without = "rossec: 1\nrobot: r\nrules: []\n"
    assert len(policy(add_rules(without, [rule()])).rules) == 1


def test_a_single_rule_without_a_dash_becomes_a_list() -> None:
    text = "rossec: 1\nrobot: r\nrules: {id: one, who: /a, allow: {call: /b}}\n"
    assert len(policy(add_rules(text, [rule()])).rules) == 2


def test_free_ids() -> None:
    assert [free_id(taken, "a") for taken in ((), ("a",), ("a", "a-2"))] == ["a", "a-2", "a-3"]


KINDS = """rossec: 1
robot: r
types: {/s: std_msgs/String, /scan: sensor_msgs/LaserScan}
rules:
  - id: "1"
    why: %s
    who: /a
    allow: {subscribe: [/s, "/scan"]}
"""


@pytest.mark.parametrize(
    "why",
    [
        '"bed  room %s"' % ("x" * 90),
        '"bed  room"',
        "'it''s  one'",
        "yes",
        '"no"',
        "0o17 and 1_000",
        "2026-11-20",
        "22:00",
        "0x1F",
        "1_000",
        "~",
        "|\n      two\n      lines  here\n",
        ">-\n      folded  text\n      of lines\n",
        '"a\\tb\\u00e9\\\n      c"',
        "plain text  of\n      two lines",
        "x" + " y" * 400,
    ],
)
def test_what_is_written_is_what_was_read_and_the_new_rule(why: str) -> None:
    before = policy(KINDS % why)
    after = policy(add_rules(KINDS % why, [rule(types={})]))
    assert [item.why for item in after.rules] == [before.rules[0].why, "because"]
    assert replace(after.rules[0], line=0) == replace(before.rules[0], line=0)
    assert (after.types, after.robot) == (before.types, before.robot)


def test_a_text_in_a_condition_keeps_its_spaces() -> None:
    """The fold of a long line made one space of two, and a withheld pose was sent."""
    when = "'" + "true && " * 12 + 'msg.data == "bed  room"\''
    text = KINDS % "none" + f"    when: {when}\n"
    text = text.replace('[/s, "/scan"]', "[/s]")
    after = policy(add_rules(text, [rule(types={})]))
    assert '"bed  room"' in after.rules[0].clauses[0].lines()[0]


def test_a_rewriting_that_changes_anything_else_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    rules_of = learn._rules
    monkeypatch.setattr(learn, "_rules", lambda data: data.update(robot="other") or rules_of(data))
    with pytest.raises(PolicyRefused, match="nothing was written") as error:
        add_rules(KINDS % "none", [rule(types={})])
    assert error.value.hint == "add the rules by hand: allow for /b (two)"

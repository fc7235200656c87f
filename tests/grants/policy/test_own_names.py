"""`{node}` is the asking node's own name, and never gives it another's, in any spelling."""

import pytest
from hypothesis import assume, example, given
from hypothesis import strategies as st

from ca.errors import NameRefused, PatternRefused
from ca.names import covers as identity_covers
from ca.names import covers_tree, pattern_covers
from grants.model import ALL_RIGHTS, Right
from grants.policy.decision import Decider
from grants.policy.model import Clause, Defaults, Effect, Policy, PolicyRule, Subject, SubjectPattern
from grants.policy.names import (
    NODE,
    any_node,
    check_rule_pattern,
    is_own,
    own_form,
    resolve,
    speaks_for_others,
)

KEY = bytes(32)
# Names that are nearly each other: a prefix, a suffix, a tail, a level more or less.
part = st.sampled_from(["r", "r_", "r_1", "r_1x", "r1", "rx", "pose", "R"])
names = st.lists(part, min_size=1, max_size=3).map(lambda parts: "/" + "/".join(parts))
rests = st.lists(st.sampled_from(["pose", "r", "r_1", "*", "**"]), max_size=2).map(
    lambda parts: "".join(f"/{each}" for each in parts)
)
odd = st.text("{}~/node.*r_1xX%\\ \u0131\u2044\uff0f\u200b", max_size=12)


@pytest.mark.parametrize(
    ("written", "expected"),
    [
        ("~/pose", "{node}/pose"),
        ("{node}/pose", "{node}/pose"),
        ("{node}", "{node}"),
        ("~/**", "{node}/**"),
        ("~/*/scan", "{node}/*/scan"),
        ("/a/*", "/a/*"),
    ],
)
def test_forms(written: str, expected: str) -> None:
    assert check_rule_pattern(written) == expected
    assert check_rule_pattern(expected) == expected
    assert is_own(expected) is ("{" in expected)


@pytest.mark.parametrize(
    ("written", "hint"),
    [
        ("~", '"{node}"'),
        ("~pose", "write ~/pose"),
        ("~/", "whole segment"),
        ("{nod}/pose", "own names are ~/pose"),
        ("{Node}/pose", "own names are"),
        ("{ node }/pose", "own names are"),
        ("{}/pose", "own names are"),
        ("{node/pose", "own names are"),
        ("node}/pose", "own names are"),
        ("/x{node}", "stands first"),
        ("{node}x/pose", "stands first"),
        ("{node}{node}", "stands first"),
        ("/{node}/pose", "stands first"),
        ("{node}/{node}", "stands first"),
        ("/a/{node}", "stands first"),
        ("~/~/pose", "own names are"),
        ("/a/~/pose", "own names are"),
        ("/rviz~/pose", "own names are"),
        ("{node}~/pose", "own names are"),
        ("{node}/", "whole segment"),
        ("{node}//pose", "whole segment"),
        ("{node}/../pose", "whole segment"),
        ("{node}/%2e", "whole segment"),
        ("{node}/po\u0455e", "whole segment"),
        ("{node}/a*", "whole segment"),
        ("/robot*/pose", "~/..."),
        ("/*_arm", "~/..."),
        ("/a/***", "whole segment"),
    ],
)
def test_what_is_refused_says_what_to_write(written: str, hint: str) -> None:
    with pytest.raises(PatternRefused) as refused:
        check_rule_pattern(written)
    assert hint in refused.value.hint


def test_for_one_node_it_is_a_pattern_below_its_name() -> None:
    assert resolve("{node}/pose", "/robot1", tail=False) == "/robot1/pose"
    assert resolve("{node}", "/robot1", tail=False) == "/robot1"
    assert resolve("{node}/**", "/a/b", tail=False) == "/a/b/**"
    assert resolve("/other/*", "/robot1", tail=True) == "/other/*"


def test_for_a_tail_it_is_a_tail_pattern() -> None:
    assert resolve("{node}/get_loggers", "/rviz", tail=True) == "/rviz~/get_loggers"
    assert resolve("{node}", "/rviz", tail=True) == "/rviz~"


def test_a_foreigner_has_no_own_names_here() -> None:
    assert resolve("{node}/pose", "/remote/hospital/rounds", tail=False) is None
    assert own_form("/remote/hospital/rounds/pose", "/remote/hospital/rounds") is None


def test_a_name_that_would_be_too_long_is_none() -> None:
    node = "/" + "n" * 200
    assert resolve("{node}/" + "p" * 53, node, tail=False) == f"{node}/{'p' * 53}"
    assert resolve("{node}/" + "p" * 54, node, tail=False) is None


@pytest.mark.parametrize(
    ("pattern", "nodes", "instead"),
    [
        ("/*/pose", ["/a", "/b"], "{node}/pose"),
        ("/*/pose", ["/robots/*"], "{node}/pose"),
        ("/**", [None], "{node}/**"),
        ("/**/pose", ["/**"], "{node}/pose"),
        ("/*/pose", ["/a"], None),
        ("/a/*", ["/a", "/b"], None),
        ("{node}/x", ["/**"], None),
    ],
)
def test_patterns_by_which_nodes_speak_for_each_other(
    pattern: str, nodes: list[str | None], instead: str | None
) -> None:
    assert speaks_for_others(pattern, nodes) == instead


@given(odd | st.builds("{}{}".format, st.sampled_from(["~", NODE, "/r", "/r_1~"]), odd))
def test_a_text_is_refused_or_of_one_of_two_forms(text: str) -> None:
    try:
        found = check_rule_pattern(text)
    except PatternRefused:
        return
    head, rest = (NODE, found[len(NODE) :]) if is_own(found) else ("", found)
    assert found.startswith(head)
    assert "{" not in rest
    assert "~" not in rest
    if head:
        assert rest == "" or text in (NODE + rest, "~" + rest)


@given(names, st.booleans(), rests, names)
@example("/rviz", True, "/pose", "/rviz_1x/pose")
@example("/rviz_1", False, "/pose", "/rviz_1x/pose")
@example("/rviz", True, "/pose", "/rviz_a/b/pose")
def test_it_never_covers_a_name_that_is_not_at_or_below_the_node(
    node: str, tail: bool, rest: str, name: str
) -> None:
    pattern = resolve(NODE + rest, node, tail=tail)
    assert pattern is not None
    depth = node.count("/") + 1
    own = "/".join(name.split("/")[:depth])
    if covers_tree(pattern, name):
        assert identity_covers(node, own, wildcard=tail)
        assert any_node(NODE + rest) in ("/**", "/**" + rest)
    if pattern_covers(pattern, name):
        assert own_form(name, node, tail=tail) == NODE + name[len(own) :]


@given(names, names, st.booleans(), rests, st.sampled_from(list(ALL_RIGHTS)))
@example("/rviz", "/rviz_1", True, "/**", Right.PROVIDE)
@example("/r/pose", "/r", False, "", Right.PARAM_SET)
def test_a_node_never_gets_the_name_of_another(
    node: str, other: str, tail: bool, rest: str, right: Right
) -> None:
    """The other is no node below it, and its name is none the certificate covers.

    Where it is one above, what is below both belongs to both: an operator names nodes otherwise.
    """
    depth = node.count("/") + 1
    assume(not identity_covers(node, "/".join(other.split("/")[:depth]), wildcard=tail))
    everyone = (SubjectPattern("*", "/**"),)
    rule = PolicyRule("own", Effect.ALLOW, everyone, (Clause(right, NODE + rest),))
    decider = Decider(Policy("r", Defaults(), {}, {}, (rule,)))
    subject = Subject(node, KEY, tail)
    below = () if node.startswith(f"{other}/") else (f"{other}/pose", f"{other}/pose/r")
    for name in (other, *below):
        assert decider.decide(subject, right, name).effect is Effect.DENY


@given(names, names, odd)
def test_what_is_asked_in_another_spelling_is_refused_or_one_of_its_names(
    node: str, other: str, tail: str
) -> None:
    rule = PolicyRule(
        "own", Effect.ALLOW, (SubjectPattern("*", "/**"),), (Clause(Right.PUBLISH, "{node}/**"),)
    )
    decider = Decider(Policy("r", Defaults(), {}, {}, (rule,)))
    asked = other + tail
    try:
        allowed = bool(decider.decide(Subject(node, KEY), Right.PUBLISH, asked))
    except NameRefused:
        return
    if allowed:
        assert asked.startswith(f"{node}/")
        assert "~" not in asked


def test_a_denial_of_a_key_denies_the_keys_above_it() -> None:
    clauses = (Clause(Right.PARAM_SET, "{node}/secret"),)
    everyone = (SubjectPattern("*", "/**"),)
    allow = PolicyRule("all", Effect.ALLOW, everyone, (Clause(Right.PARAM_SET, "/**"),))
    deny = PolicyRule("own", Effect.DENY, everyone, clauses)
    decider = Decider(Policy("r", Defaults(), {}, {}, (allow, deny)))
    subject = Subject("/a/b", KEY)
    for name, expected in (
        ("/a", False),
        ("/a/b", False),
        ("/a/b/secret", False),
        ("/a/b/secret/x", False),
        ("/a/b/other", True),
        ("/a/c", True),
        ("/a/c/secret", True),
    ):
        assert bool(decider.decide(subject, Right.PARAM_SET, name)) is expected, name

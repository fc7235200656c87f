"""Values that exist are well-formed."""

from dataclasses import replace
from typing import Any

import pytest

from ca.errors import PatternRefused
from grants.errors import FilterRefused, GrantMalformed
from grants.model import Draft, FilterRule, Grant, Permission, Restriction, Right, filter_rules, merge

RULE = FilterRule("a.b[*].c", "round", (("step", 0.5),))
DRAFT: dict[str, Any] = {
    "domain": "home",
    "subject": "/a",
    "holder": bytes(32),
    "not_before": 1,
    "expires": 2,
    "cap": 2,
    "serial": bytes(16),
    "permissions": (Permission("/a", Right.CALL),),
}


def test_rights_have_the_bits_of_the_format() -> None:
    assert [int(right) for right in Right] == [1, 2, 4, 8, 16, 32, 64, 128]
    assert Right.PARAM_GET.label == "param-get"
    assert (Right.PUBLISH | Right.ADMIN).label == "publish, admin"


def test_filter_rules_are_sorted() -> None:
    rules: dict[str, dict[str, object]] = {"b": {"clear": True}, "a": {"clamp": {"low": 0, "high": 1}}}
    expected = (FilterRule("a", "clamp", (("high", 1), ("low", 0))), FilterRule("b", "clear"))
    assert filter_rules(rules) == expected
    assert [str(rule) for rule in expected] == ["a: clamp high 1 low 0", "b: clear"]


@pytest.mark.parametrize(
    ("rules", "message"),
    [
        ({"a": {}}, "a: exactly one operator per field"),
        ({"a": {"clear": True, "drop": True}}, "exactly one operator"),
        ({"a": {"clear": False}}, "parameters of clear must be named"),
        ({"a": {"round": 0.5}}, "parameters of round must be named"),
        ({"a": {"round": {}}}, "parameters of round must be named"),
        ({"a": {"round": {"step": [1]}}}, "parameter 'step' is not a number, text"),
        ({"a": {"round": {1: 1}}}, "parameter 1 is not"),
        ({"a..b": {"clear": True}}, "not a field path: 'a..b'"),
        ({"a[0]": {"clear": True}}, "not a field path"),
        ({"a\n": {"clear": True}}, "not a field path"),
        ({"": {"clear": True}}, "not a field path"),
    ],
)
def test_invalid_filter_rules_are_refused(rules: Any, message: str) -> None:
    with pytest.raises(FilterRefused, match=message):
        filter_rules(rules)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((None, (), ()), "restricts nothing"),
        (("Pose", ("true",), ()), "not a message type"),
        ((None, (), (RULE,)), "without a message type"),
        (("a/B", (), (RULE, FilterRule(RULE.path, "clear"))), "two filters for one field"),
        ((None, ("",), ()), "empty or longer than 1000"),
        ((None, ("x" * 1001,), ()), "empty or longer than 1000"),
    ],
)
def test_invalid_restrictions_are_refused(arguments: Any, message: str) -> None:
    with pytest.raises(GrantMalformed, match=message):
        Restriction(*arguments)


def test_restrictions_as_text_and_merged() -> None:
    one, two = Restriction("a/B", ("true",), (RULE,)), Restriction(conditions=("false",))
    assert one.lines() == ["only when true", "a.b[*].c: round step 0.5"]
    assert merge([one, None, two, one]) == merge([two, one])
    assert set(merge([one, two])) == {one, two}


def test_permissions_cover_names_and_are_checked() -> None:
    permission = Permission("/a/*", Right.CALL | Right.PARAM_GET)
    assert permission.covers(Right.CALL, "/a/b")
    assert not permission.covers(Right.CALL, "/a/b/c")
    assert permission.covers(Right.PARAM_GET, "/a/b/c")
    assert not permission.covers(Right.PARAM_SET, "/a/b")
    with pytest.raises(PatternRefused):
        Permission("a", Right.CALL)
    for bits in (Right(0), Right(256)):
        with pytest.raises(GrantMalformed, match="unknown or no right"):
            Permission("/a", bits)
    with pytest.raises(GrantMalformed, match="graph on /a cannot be restricted"):
        Permission("/a", Right.GRAPH, Restriction(conditions=("true",)))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"domain": ""}, "trust domain"),
        ({"holder": b""}, "holder must be 32 bytes"),
        ({"serial": b""}, "serial 16"),
        ({"expires": 1}, "not_before < expires <= cap"),
        ({"cap": 1}, "not_before < expires <= cap"),
        ({"permissions": ()}, "permits nothing"),
        ({"may_narrow": 4}, "at most 3 narrowings"),
        ({"may_narrow": -1}, "at most 3 narrowings"),
    ],
)
def test_invalid_drafts_are_refused(changes: Any, message: str) -> None:
    with pytest.raises(GrantMalformed, match=message):
        Draft(**{**DRAFT, **changes})


def test_a_grant_is_a_draft_with_id_and_issuer() -> None:
    grant = Grant.of(Draft(**DRAFT), id=b"\xab" * 16, issuer=bytes(32))
    assert grant == Grant(**DRAFT, id=b"\xab" * 16, issuer=bytes(32))
    assert grant.short_id == "abababab"


def test_every_link_of_a_chain_must_cover() -> None:
    base = Grant.of(Draft(**DRAFT), id=bytes(16), issuer=bytes(32))
    narrow = replace(
        base,
        id=b"n" * 16,
        via=(b"v",),
        holder=b"h" * 32,
        permissions=(Permission("/a", Right.CALL | Right.PUBLISH),),
    )
    chain = replace(base, permissions=base.permissions, chain=(base, narrow))
    assert (base.links, chain.links) == ((base,), (base, narrow))
    assert base.revocable == (base.id,)
    assert chain.revocable == (b"n" * 16, b"v", base.id, base.holder, b"h" * 32)
    for right in Right:
        for name in ("/a", "/a/b"):
            both = all(link.covers(right, name) for link in chain.links)
            assert chain.covers(right, name) == both
    draft = Draft(**DRAFT)
    assert all(draft.covers(right, "/a") == base.covers(right, "/a") for right in Right)


def test_layers_come_one_after_the_other() -> None:
    early, late = Restriction(rate=9), Restriction(rate=1, layer=1)
    assert merge([late, early, late]) == merge([early, late]) == (early, late)


def test_keep_when_stale_does_not_restrict_messages() -> None:
    keep = Restriction(keep_when_stale=True)
    both = Restriction(rate=2, keep_when_stale=True)
    assert keep.lines() == ["kept while revocation data is stale"]
    assert both.lines()[0] == "at most 2 messages a second"
    assert merge([keep, both, None]) == (Restriction(rate=2),)


def test_limits_as_text() -> None:
    lines = [Restriction(rate=rate).lines() for rate in (5, 0.2, 0.1, 1 / 30)]
    assert lines == [
        ["at most 5 messages a second"],
        ["at most 0.2 messages a second"],
        ["at most 0.1 messages a second"],
        ["at most one message every 30 s"],
    ]
    assert Restriction(slot=60).lines() == ["one message at the start of each 60 s"]
    assert Restriction(slot=60).restricts_messages
    assert Restriction(slot=60, body="robot").lines() == [
        "one message at the start of each 60 s",
        "with all topics of the body robot",
    ]


def test_padding_is_for_what_is_subscribed_to_alone() -> None:
    padded = Restriction(pad=256)
    assert padded.lines() == ["padded to multiples of 256 bytes"]
    assert padded.restricts_messages
    assert Permission("/a", Right.SUBSCRIBE, padded).restriction == padded
    for rights in (Right.PUBLISH, Right.CALL, Right.SUBSCRIBE | Right.PUBLISH):
        with pytest.raises(GrantMalformed, match="on /a cannot be padded"):
            Permission("/a", rights, padded)


@pytest.mark.parametrize("pad", [0, 31, 65_537, -64])
def test_padding_has_bounds(pad: int) -> None:
    with pytest.raises(GrantMalformed, match="padded to 32 to 65536 bytes"):
        Restriction(pad=pad)


@pytest.mark.parametrize("slot", [9, 86_401, 0, -60])
def test_a_slot_has_a_length(slot: int) -> None:
    with pytest.raises(GrantMalformed, match="a slot must have 10 to 86400 seconds"):
        Restriction(slot=slot)

"""Claims of a grant: every invalid claim is refused by name, and nothing else is accepted."""

from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ca.encoding import decode, encode
from grants import document
from grants import document as claims
from grants.errors import GrantMalformed
from grants.model import Permission, Restriction, Right
from tests.grants.authority import CA, COARSE, DRAFT, NOW, draft, granted, signed_claims

DATA = document.sign(CA, DRAFT)
BODY: bytes = document.GRANT.peek_body(DATA)


def payload() -> Any:
    return document.GRANT.peek(DATA)


def scope(*entries: Any) -> Callable[[Any], Any]:
    return lambda claims: claims | {9: encode(list(entries))}


def restricted(restriction: Any) -> Callable[[Any], Any]:
    return scope(["/a", 2, restriction])


def without(key: int) -> Callable[[Any], Any]:
    return lambda claims: {name: value for name, value in claims.items() if name != key}


def put(key: int | str, value: Any) -> Callable[[Any], Any]:
    return lambda claims: claims | {key: value}


TYPE, URI = "a/B", "urn:ietf:params:oauth:ckt:sha-256:"
CLAIMS: dict[str, tuple[Callable[[Any], Any], str]] = {
    "sibling claim": (put(-70000, {"filters": 1}), "unknown claim -70000"),
    "sibling claim with a text key": (put("filters", 1), "unknown claim filters"),
    "no narrowings": (put(-70034, 0), "says it allows no narrowings"),
    "too many narrowings": (put(-70034, 4), "allows at most 3 narrowings"),
    "negative narrowings": (put(-70034, -1), "allows at most 3 narrowings"),
    "narrowings are true": (put(-70034, True), "may_narrow of a grant is of a wrong type"),
    "narrowings are text": (put(-70034, "1"), "may_narrow of a grant is of a wrong type"),
    "not a map": (lambda claims: [claims], "not a map"),
    "missing exp": (without(4), "claim 4 is missing"),
    "missing cnf": (without(8), "claim 8 is missing"),
    "missing cap": (without(-65537), "claim -65537 is missing"),
    "iat": (put(6, 1), "unknown claim 6"),
    "exp is text": (put(4, "never"), "exp of a grant is of a wrong type"),
    "exp is true": (put(4, True), "exp of a grant is of a wrong type"),
    "exp is a float": (put(4, 1.5e9), "exp of a grant is of a wrong type"),
    "exp before nbf": (put(4, 1), "not_before < expires <= cap"),
    "cap before exp": (put(-65537, NOW), "not_before < expires <= cap"),
    "cap beyond time": (put(-65537, 1 << 60), "not_before < expires <= cap"),
    "negative nbf": (put(5, -1), "not_before < expires <= cap"),
    "short serial": (put(7, b"1"), "serial 16"),
    "short holder": (put(8, {5: b"1"}), "holder must be 32 bytes"),
    "holder key": (put(8, {1: {1: 2}}), "unknown confirmation 1"),
    "holder and more": (put(8, {5: bytes(32), 3: b"kid"}), "unknown confirmation 3"),
    "relative subject": (put(2, "heating"), "not an absolute ROS name"),
    "subject is bytes": (put(2, b"/heating"), "sub of a grant"),
    "no domain": (put(3, ""), "trust domain"),
    "domain of 256 bytes": (put(3, "\u00e4" * 128), "trust domain of 1 to 255 bytes"),
    "iss is bytes": (put(1, bytes(32)), "iss of a grant"),
    "iss is another uri": (put(1, "urn:x"), "thumbprint URI"),
    "iss is short": (put(1, URI + "AAAA"), "thumbprint URI"),
    "iss with odd last bits": (put(1, URI + "A" * 42 + "B"), "thumbprint URI"),
    "iss is not base64": (put(1, URI + "!" * 43), "thumbprint URI"),
    "scope is an array": (put(9, [["/a", 1]]), "scope of a grant"),
    "scope is a map": (put(9, encode({1: 2})), "scope of a grant"),
    "scope is not strict": (put(9, b"\x98\x00"), "in a grant"),
    "empty scope": (scope(), "permits nothing"),
    "entry is a map": (scope({1: 2}), "not .pattern, rights, restrictions."),
    "entry is too long": (scope(["/a", 1, {1: ["true"]}, 1]), "not .pattern"),
    "entry with null": (scope(["/a", 1, None]), "restrictions of a grant are not a map"),
    "pattern": (scope(["/a*", 1]), "not a name pattern"),
    "tail pattern of another node": (scope(["/heatin~/a", 1]), "tail pattern of another node"),
    "tail pattern beside a good one": (scope(["/a", 1], ["/a~/b", 8]), "tail pattern of another"),
    "tail pattern of a reserved node": (scope(["/master~/a", 1]), "not a tail pattern"),
    "tail that is no segment's end": (scope(["/heating~x", 1]), "not a tail pattern"),
    "tail before nothing": (scope(["/heating~/", 1]), "not a name pattern"),
    "two tails": (scope(["/heating~/a~", 1]), "not a name pattern"),
    "tail after a wildcard": (scope(["/*~/a", 1]), "not a tail pattern"),
    "tail alone": (scope(["~/a", 1]), "not a tail pattern"),
    "tail pattern that may be narrowed": (
        lambda claims: scope(["/heating~/a", 1])(claims) | {-70034: 1},
        "may be narrowed",
    ),
    "no right": (scope(["/a", 0]), "unknown or no right: 0"),
    "right is true": (scope(["/a", True]), "rights of a grant"),
    "unknown right bit": (scope(["/a", 257]), "unknown or no right: 257"),
    "negative right": (scope(["/a", -1]), "unknown or no right"),
    "huge right": (scope(["/a", 1 << 63]), "unknown or no right"),
    "restricted admin": (scope(["/a", 128, {1: ["true"]}]), "cannot be restricted"),
    "unknown restriction": (restricted({5: {"rate": 1}, 1: ["true"]}), "unknown restriction 5"),
    "on_stale is no word": (restricted({4: "cut", 1: ["true"]}), "on_stale of a grant is not keep"),
    "unknown limit": (restricted({3: {"delay": 1, "rate": 1}}), "unknown limit delay"),
    "empty limits": (restricted({3: {}, 1: ["true"]}), "an empty restriction"),
    "limits are a number": (restricted({3: 1}), "a restriction of a grant is of a wrong type"),
    "rate is text": (restricted({3: {"rate": "1"}}), "rate of a grant is of a wrong type"),
    "rate is true": (restricted({3: {"rate": True}}), "rate of a grant is of a wrong type"),
    "rate of nothing": (restricted({3: {"rate": 0}}), "a rate must be above zero"),
    "rate without end": (restricted({3: {"rate": float("inf")}}), "a rate must be above zero"),
    "slot is text": (restricted({3: {"slot": "60"}}), "slot of a grant is of a wrong type"),
    "slot is true": (restricted({3: {"slot": True}}), "slot of a grant is of a wrong type"),
    "slot is a float": (restricted({3: {"slot": 60.5}}), "slot of a grant is of a wrong type"),
    "slot of 9 s": (restricted({3: {"slot": 9}}), "a slot must have 10 to 86400 seconds"),
    "slot of more than a day": (restricted({3: {"slot": 86401}}), "a slot must have 10 to 86400"),
    "body alone": (restricted({3: {"body": "robot"}}), "restricts nothing"),
    "body beside a rate": (
        restricted({3: {"rate": 1, "body": "robot"}}),
        "a body has a slot and a name, not 'robot'",
    ),
    "pad is text": (restricted({3: {"pad": "64"}}), "pad of a grant is of a wrong type"),
    "pad is true": (restricted({3: {"pad": True}}), "pad of a grant is of a wrong type"),
    "pad of 16": (restricted({3: {"pad": 16}}), "padded to 32 to 65536 bytes"),
    "body is a number": (restricted({3: {"slot": 60, "body": 1}}), "body of a grant is of a wrong"),
    "body without a name": (restricted({3: {"slot": 60, "body": ""}}), "a body has a slot and a n"),
    "body with a space": (restricted({3: {"slot": 60, "body": "a b"}}), "a body has a slot and a"),
    "text restriction": (restricted({"rate": 1}), "unknown restriction rate"),
    "empty restriction": (restricted({}), "restricts nothing"),
    "only a type": (restricted({0: TYPE}), "restricts nothing"),
    "empty conditions": (restricted({0: TYPE, 1: [], 2: {"x": {"clear": True}}}), "an empty"),
    "empty filters": (restricted({0: TYPE, 1: ["true"], 2: {}}), "an empty restriction"),
    "filters without type": (restricted({2: {"x": {"clear": True}}}), "without a message type"),
    "bad type": (restricted({0: "Pose", 1: ["true"]}), "not a message type"),
    "type is a number": (restricted({0: 1, 1: ["true"]}), "type of a grant"),
    "condition is a number": (restricted({1: [1]}), "a condition of a grant"),
    "conditions is text": (restricted({1: "true"}), "a restriction of a grant"),
    "empty condition": (restricted({1: [""]}), "a condition is empty"),
    "long condition": (restricted({1: ["t" * 1001]}), "a condition is empty or longer"),
    "filter is text": (restricted({0: TYPE, 2: {"x": "clear"}}), "a filter of a grant"),
    "path is a number": (restricted({0: TYPE, 2: {7: {"clear": True}}}), "a field path is text"),
    "operator is a number": (restricted({0: TYPE, 2: {"x": {7: True}}}), "an operator is text"),
    "unknown operator": (restricted({0: TYPE, 2: {"x": {"blur": True}}}), "unknown operator"),
    "unknown parameter": (
        restricted({0: TYPE, 2: {"x": {"round": {"step": 1, "half": 1}}}}),
        "expected step",
    ),
    "empty operator": (restricted({0: TYPE, 2: {"x": {}}}), "exactly one operator"),
    "bad path": (restricted({0: TYPE, 2: {"x..y": {"clear": True}}}), "not a field path"),
    "bad parameter": (restricted({0: TYPE, 2: {"x": {"round": {"step": b"1"}}}}), "parameter"),
}


@pytest.mark.parametrize("name", CLAIMS)
def test_invalid_claims_are_refused(name: str) -> None:
    change, message = CLAIMS[name]
    with pytest.raises(GrantMalformed, match=message):
        document.open_grant(signed_claims(change(payload())), CA.public_key, NOW)


@pytest.mark.parametrize("count", [1, 2, 3])
def test_how_often_it_may_be_narrowed_is_read_by_either_check(count: int) -> None:
    made = replace(DRAFT, may_narrow=count)
    data = document.sign(CA, made)
    assert document.open_grant(data, CA.public_key, NOW).may_narrow == count
    long = replace(made, domain="\u00e4")  # not in ASCII: read by the general check
    assert document.open_grant(document.sign(CA, long), CA.public_key, NOW).may_narrow == count


def test_claims_of_unusual_length_are_read() -> None:
    """Texts, lengths and times that the quick comparison does not expect are read correctly."""
    far = draft(domain="zuh\u00e4use", not_before=0, expires=1 << 40, cap=1 << 41)
    assert document.open_grant(document.sign(CA, far), CA.public_key, NOW).domain == "zuh\u00e4use"


def test_on_stale_is_read_as_it_was_written() -> None:
    for restriction in (Restriction(keep_when_stale=True), replace(COARSE, keep_when_stale=True)):
        grant = granted(Permission("/stop", Right.SUBSCRIBE, restriction))
        assert grant.permissions[0].restriction == restriction


@settings(max_examples=300)
@given(st.binary(max_size=300), st.integers(0, len(BODY)), st.integers(0, 40))
def test_fuzzed_claims_are_read_or_refused(noise: bytes, at: int, cut: int) -> None:
    """Accepted claims have one encoding."""
    body = BODY[:at] + noise + BODY[at + cut :]
    with suppress(GrantMalformed):
        claims.read_claims(body, bytes(16))
        assert encode(decode(body)) == body

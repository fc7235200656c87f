"""Narrowings: the form, each rule violated once, the domain a chain stays in."""

import hashlib
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import pytest

from ca.encoding import Value, encode
from ca.keys.signing import KeySigner, thumbprint, thumbprint_of, to_coordinates
from grants import token
from grants.document import issuer_uri, scope_of
from grants.errors import (
    ConditionRefused,
    GrantError,
    GrantExpired,
    GrantForged,
    GrantForOther,
    GrantMalformed,
    GrantNotYetValid,
    GrantTooWide,
)
from grants.model import Grant, Permission, Restriction, Right
from grants.token import NARROWING, check_one_domain, follow, peek_chain, sign_narrowing, verify_chain
from tests.grants.authority import NOW, granted
from tests.grants.chains import A, B, C, D, Made, first, following, key_of

N_P256 = 0xFFFFFFFF00000000FFFFFFFFFFFFFFFFBCE6FAADA7179E84F3B9CAC2FC632551
POSE = Permission("/robot/pose", Right.SUBSCRIBE)


def long_chain() -> Made:
    return first().narrowed(A, POSE).narrowed(B, POSE).narrowed(C, POSE)


def test_a_chain_is_one_grant_of_the_last_holder() -> None:
    made = long_chain()
    base = first().grant
    grant = follow(base, made.narrowings, NOW)
    assert (grant.holder, grant.subject, grant.may_narrow) == (key_of(D), "/d", 0)
    assert [link.holder for link in grant.links] == [key_of(each) for each in (A, B, C, D)]
    assert (grant.links[0], grant.id) == (base, grant.links[-1].id)
    assert grant.cap == grant.expires
    ids = [link.id for link in reversed(grant.links)]
    assert grant.revocable == (*ids, *(link.holder for link in grant.links))
    assert peek_chain(base, made.narrowings) == verify_chain(base, made.narrowings) == grant


def test_the_id_is_that_of_the_specification() -> None:
    made = first().narrowed(A)
    (data,) = made.narrowings
    body, protected = NARROWING.peek_body(data), NARROWING.protected
    length = len(protected).to_bytes(4)
    text = b"rossec-narrowing-id\0" + length + protected + body
    assert made.grant.id == hashlib.sha256(text).digest()[:16]


def test_a_chain_ends_with_the_link_that_ends_first() -> None:
    for ends in ((NOW + 30, NOW + 50), (NOW + 50, NOW + 30)):
        made = first().narrowed(A, expires=ends[0]).narrowed(B, expires=ends[1], not_before=NOW - 1)
        assert (made.grant.not_before, made.grant.expires) == (NOW - 1, NOW + 30)
        follow(first().grant, made.narrowings, NOW + 29)
        with pytest.raises(GrantExpired):
            follow(first().grant, made.narrowings, NOW + 30)
        with pytest.raises(GrantNotYetValid):
            follow(first().grant, made.narrowings, NOW - 2)


# The claims of a narrowing by A, to be changed one at a time.


def claims(parent: Grant, by: KeySigner = A) -> dict[int | str, Value]:
    key = to_coordinates(by.public_key)
    return {
        1: issuer_uri(thumbprint(by.public_key)),
        2: "/b",
        3: "home",
        4: NOW + 50,
        5: NOW - 5,
        7: bytes(16),
        8: {5: key_of(B)},
        9: scope_of([POSE]),
        -70032: parent.id,
        -70033: [key[:32], key[32:]],
        -70034: 0,
    }


def refusal(parent: Grant, data: bytes) -> type[GrantError]:
    with pytest.raises(GrantError) as refused:
        follow(parent, [data], NOW)
    assert str(refused.value)
    return type(refused.value)


def test_the_claims_the_other_cases_change_are_accepted() -> None:
    parent = first().grant
    assert follow(parent, [NARROWING.sign(A, claims(parent))], NOW).subject == "/b"


BROKEN: Mapping[str, tuple[Any, type[GrantError]]] = {
    "iss of another": ({1: issuer_uri(bytes(32))}, GrantForged),
    "iss of the next": ({1: issuer_uri(key_of(B))}, GrantForged),
    "sub": ({2: "robot"}, GrantMalformed),
    "aud": ({3: "work"}, GrantForOther),
    "no aud": ({3: ""}, GrantMalformed),
    "expired": ({4: NOW}, GrantExpired),
    "a text as a time": ({4: "5"}, GrantMalformed),
    "not yet": ({5: NOW + 1}, GrantNotYetValid),
    "never": ({5: NOW + 50}, GrantMalformed),
    "cti": ({7: bytes(15)}, GrantMalformed),
    "cnf": ({8: {5: bytes(31)}}, GrantMalformed),
    "more in cnf": ({8: {5: bytes(32), 6: 1}}, GrantMalformed),
    "no right": ({9: encode([])}, GrantMalformed),
    "a right that does not exist": ({9: encode([["/a", 256]])}, GrantMalformed),
    "an administrator who filters": ({9: encode([["/a", 128, {3: {"rate": 1}}]])}, GrantMalformed),
    "a graph under conditions": ({9: encode([["/a", 64, {1: ["true"]}]])}, GrantMalformed),
    "parameters at a rate": ({9: encode([["/a", 16, {3: {"rate": 1}}]])}, GrantMalformed),
    "a parent that is another": ({-70032: bytes(16)}, GrantForOther),
    "a short parent": ({-70032: bytes(15)}, GrantMalformed),
    "the key of another": ({-70033: [key_of(B), key_of(B)]}, GrantForged),
    "no point": ({-70033: [bytes(32), bytes(32)]}, GrantForged),
    "a short key": ({-70033: [bytes(31), bytes(33)]}, GrantMalformed),
    "no key": ({-70033: []}, GrantMalformed),
    "a counter that does not fall": ({-70034: 3}, GrantTooWide),
    "a counter that rises": ({-70034: 4}, GrantMalformed),
    "a counter below zero": ({-70034: -1}, GrantMalformed),
    "a truth as a counter": ({-70034: True}, GrantMalformed),
    "a claim more": ({10: 1}, GrantMalformed),
    "a cap": ({-65537: NOW + 50}, GrantMalformed),
}


@pytest.mark.parametrize("name", sorted(BROKEN))
def test_each_rule_violated_once(name: str) -> None:
    changes, expected = BROKEN[name]
    parent = first().grant
    assert refusal(parent, NARROWING.sign(A, claims(parent) | changes)) is expected


@pytest.mark.parametrize("claim", [1, 2, 3, 4, 5, 7, 8, 9, -70032, -70033, -70034])
def test_each_claim_is_needed(claim: int) -> None:
    parent = first().grant
    wanted = claims(parent)
    del wanted[claim]
    assert refusal(parent, NARROWING.sign(A, wanted)) is GrantMalformed


def test_a_narrowing_is_signed_by_the_key_it_names() -> None:
    parent = first().grant
    forged = NARROWING.sign(C, claims(parent))
    assert refusal(parent, forged) is GrantForged
    assert refusal(parent, NARROWING.sign(C, claims(parent, C))) is GrantForged
    other = first(holder=C, subject="/c").grant
    assert refusal(other, NARROWING.sign(A, claims(other))) is GrantForged


def test_a_holder_without_a_key_hands_nothing_on() -> None:
    nobody = replace(first().grant, holder=thumbprint_of(bytes(64)))
    signed = NARROWING.sign(A, claims(nobody) | {-70033: [bytes(32), bytes(32)]})
    with pytest.raises(GrantForged, match="not a point"):
        verify_chain(nobody, [signed])


def test_every_byte_counts() -> None:
    parent = first().grant
    data = NARROWING.sign(A, claims(parent))
    for at in range(len(data)):
        with pytest.raises(GrantError):
            follow(parent, [data[:at] + bytes([data[at] ^ 1]) + data[at + 1 :]], NOW)
        with pytest.raises(GrantError):
            follow(parent, [data[:at]], NOW)
    assert refusal(parent, data + b"\0") is GrantMalformed


def test_the_twin_of_a_signature_has_the_same_id() -> None:
    made = first().narrowed(A)
    (data,) = made.narrowings
    twin = data[:-32] + (N_P256 - int.from_bytes(data[-32:])).to_bytes(32)
    assert follow(first().grant, [twin], NOW).id == made.grant.id


def test_the_order_and_the_parent_count() -> None:
    base, made = first().grant, long_chain()
    one, two, three = made.narrowings
    for order in ((two, one, three), (one, three), (two,), (one, one), (one, two, two)):
        with pytest.raises(GrantError):
            follow(base, order, NOW)
    other = first(serial=b"o" * 16).grant
    assert refusal(other, one) is GrantForOther
    sibling = first().narrowed(A, serial=b"s" * 16)
    with pytest.raises(GrantForOther):  # replayed below another narrowing of the same key
        follow(base, (*sibling.narrowings, two), NOW)


def test_no_more_narrowings_than_allowed() -> None:
    plain = granted()
    with pytest.raises(GrantTooWide, match="allows 0 narrowings") as refused:
        follow(plain, first().narrowed(A).narrowings, NOW)
    assert "--may-narrow" in refused.value.hint
    once = first(may_narrow=1)
    made = once.narrowed(A)
    with pytest.raises(GrantTooWide):
        made.narrowed(B, may_narrow=0)
    with pytest.raises(GrantTooWide):
        once.narrowed(A, may_narrow=1)
    with pytest.raises(GrantTooWide):
        follow(first().grant, [], NOW)
    four = [*long_chain().narrowings, long_chain().narrowings[0]]
    with pytest.raises(GrantTooWide):
        follow(first().grant, four, NOW)


def test_only_what_verifiers_accept_is_signed() -> None:
    parent = first().grant
    with pytest.raises(GrantForged):
        sign_narrowing(B, following(parent), parent)
    with pytest.raises(GrantForOther):
        sign_narrowing(A, following(parent, domain="work"), parent)
    bad = Permission("/a", Right.CALL, Restriction(conditions=("now.getHours(",)))
    with pytest.raises(ConditionRefused):
        sign_narrowing(A, following(parent, bad), parent)
    large = [Permission(f"/{'a' * 200}{number}", Right.CALL) for number in range(100)]
    with pytest.raises(GrantMalformed, match="at most 16384"):
        sign_narrowing(A, following(parent, *large), parent)


def test_a_narrowing_is_no_grant_and_a_grant_no_narrowing() -> None:
    made = first().narrowed(A)
    with pytest.raises(GrantMalformed):
        token.peek(made.narrowings[0])
    assert refusal(first().grant, first().token) is GrantMalformed


@pytest.mark.parametrize(
    ("sub", "label", "peer", "stays"),
    [
        # judged by a node of the domain whose authority signed the grant
        ("/remote/hospital/a", "", "/remote/hospital/b", True),
        ("/remote/hospital/a", "", "/remote/clinic/b", False),
        ("/remote/hospital/a", "", "/b", False),
        ("/a", "", "/b", True),
        ("/a", "", "/remote/hospital/b", False),
        # judged by a node of another domain, which calls that one `home`
        ("/a", "home", "/remote/home/b", True),
        ("/a", "home", "/b", False),
        ("/a", "home", "/remote/clinic/b", False),
        ("/remote/us/a", "home", "/b", True),
        ("/remote/us/a", "home", "/remote/home/b", False),
        ("/remote/us/a", "home", "/remote/us/b", False),
        ("/remote", "", "/b", False),
        ("/a", "", "/remote/x", False),
    ],
)
def test_a_chain_stays_in_one_domain(sub: str, label: str, peer: str, stays: bool) -> None:
    grant = first(subject=sub).narrowed(A).grant
    if stays:
        check_one_domain(grant, label, peer)
        return
    with pytest.raises(GrantForOther) as refused:
        check_one_domain(grant, label, peer)
    assert refused.value.hint


def test_a_single_grant_may_be_of_any_domain() -> None:
    check_one_domain(first().grant, "", "/b")

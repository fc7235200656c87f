"""What the authority says of a thing: strict, one encoding, bound to one border router."""

import dataclasses
import json
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from ca import things as module
from ca.errors import CAError, NameRefused, ThingOutdated, ThingRefused
from ca.things import (
    THING,
    ThingSecret,
    check_thing_name,
    open_statement,
    peek_statement,
    sign_statement,
    verify_statement,
)
from tests.vectors.make_things import FILE, HOME, KEY, NOW, OTHER, STATEMENTS, claims

V = json.loads(FILE.read_text())
LAMP = STATEMENTS["a key"]
DATA = bytes.fromhex(V["statements"]["a key"]["data"])
CA_KEY = HOME.public_key


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("a claim is missing", "missing or unknown claims"),
        ("another domain", "of the trust domain 'hospital', not of 'home'"),
        ("a relative name", "not an absolute ROS name"),
        ("a master's name", "/master cannot be the name of a thing"),
        ("an alias", "cannot be the name of a thing"),
        ("never valid", "never valid"),
        ("a truth for a time", "out of range"),
        ("a short serial", "a wrong length"),
        ("an empty subject", "empty, or not text"),
        ("a key no point of the curve", "not a point of P-256"),
        ("a key and a secret", "not a P-256 key with kid"),
        ("a secret's kid of 8 octets", "a sender ID of 8 octets, 1 to 7"),
        ("another key", "does not verify"),
        ("another kind", "not a statement of kind rossec-thing"),
        ("more than 1024 octets", "at most 1024"),
        ("expired", "expired 0 s ago"),
        ("not valid yet", "not valid for another 1 s"),
    ],
)
def test_the_reason_for_a_refusal(name: str, message: str) -> None:
    with pytest.raises(ThingRefused, match=message):
        open_statement(bytes.fromhex(V["refused"][name]["data"]), CA_KEY, NOW, domain="home")


def test_every_byte_of_a_statement_counts() -> None:
    for at in range(len(DATA)):
        changed = DATA[:at] + bytes([DATA[at] ^ 1]) + DATA[at + 1 :]
        for data in (changed, DATA[:at]):
            with pytest.raises(ThingRefused):
                open_statement(data, CA_KEY, NOW, domain="home")
    with pytest.raises(ThingRefused):
        open_statement(DATA + b"\0", CA_KEY, NOW, domain="home")


@given(st.binary(max_size=300))
def test_other_bytes_are_no_statement(data: bytes) -> None:
    for read in (peek_statement,):
        with pytest.raises(ThingRefused):
            read(data)


def test_it_is_valid_from_its_first_second_to_before_its_last() -> None:
    short = dataclasses.replace(LAMP, expires=NOW + 2)
    short.check_time(NOW)
    short.check_time(NOW + 1)
    with pytest.raises(ThingOutdated) as caught:
        short.check_time(NOW + 2)
    assert "rossec ca thing /things/lamp --renew" in caught.value.hint
    with pytest.raises(ThingOutdated):
        short.check_time(NOW - 1)
    assert verify_statement(sign_statement(HOME, short), CA_KEY, domain="home") == short


def test_its_id_is_in_no_signature() -> None:
    again = THING.sign(HOME, claims(n70040=KEY.subject))
    by_another = THING.sign(OTHER, claims(n70040=KEY.subject))
    assert peek_statement(again).id == peek_statement(by_another).id == peek_statement(DATA).id == LAMP.id
    assert peek_statement(THING.sign(HOME, claims())).id != LAMP.id


def test_it_can_be_shown_without_the_authority() -> None:
    assert peek_statement(DATA) == LAMP
    for name in ("another key", "expired"):
        found = peek_statement(bytes.fromhex(V["refused"][name]["data"]))
        assert found.name == "/things/lamp"


def test_the_class_of_a_thing() -> None:
    assert LAMP.kind == module.EDHOC
    secret = STATEMENTS["a secret"]
    assert (secret.kind, type(secret.credential)) == (module.PSK, ThingSecret)


def test_the_largest_statement_is_within_the_limit() -> None:
    large = dataclasses.replace(
        LAMP,
        name="/" + "a" * 254,
        domain="d" * 255,
        expires=(1 << 53) - 1,
        credential=dataclasses.replace(KEY, kid=bytes(8), subject="ü" * 32),
    )
    data = sign_statement(HOME, large)
    assert len(data) < module.MAX_STATEMENT
    assert open_statement(data, CA_KEY, NOW, domain=large.domain) == large


@pytest.mark.parametrize(
    "changes",
    [
        {"domain": "Home"},
        {"name": "lamp"},
        {"name": "/relay"},
        {"border": b""},
        {"not_before": NOW + 2**40},
        {"expires": 1 << 53},
        {"serial": b""},
        {"expires": 1.5},
    ],
)
def test_none_is_made_that_would_be_refused(changes: dict[str, Any]) -> None:
    with pytest.raises(CAError):
        dataclasses.replace(LAMP, **changes)


def test_a_things_name() -> None:
    assert check_thing_name("/kitchen/lamp") == "/kitchen/lamp"
    with pytest.raises(NameRefused):
        check_thing_name("~lamp")
    with pytest.raises(ThingRefused) as caught:
        check_thing_name("/ca")
    assert "/things/lamp" in caught.value.hint

"""Pseudonyms: HMAC-SHA-256, by named keys, and nothing without a key."""

import hashlib
import hmac

import pytest

from grants.errors import FilterRefused, MessageRefused
from grants.filters.compile import compile_filter
from grants.filters.hashing import check_key_name, is_personal, key_names, pseudonyms, receiver_keys
from grants.model import filter_rules
from tests.grants.messages import layout, text

KEYS = {"ward": bytes(range(32)), "other": bytes(32)}
LAYOUT = layout("string a\nstring[] b\nS[] c", "MSG: t/S\nstring id\nint32 n")


def hashed(length: int | None = None, key: str = "ward") -> dict[str, object]:
    return {"hash": {"key": key} | ({"length": length} if length is not None else {})}


def digest(value: str, key: str = "ward") -> str:
    return hmac.new(KEYS[key], value.encode(), hashlib.sha256).hexdigest()


def message(a: str, *b: str, c: str = "") -> bytes:
    names = len(b).to_bytes(4, "little") + b"".join(map(text, b))
    return text(a) + names + (1).to_bytes(4, "little") + text(c) + bytes(4)


def test_a_pseudonym_is_a_truncated_hmac() -> None:
    rules = {"a": hashed(), "b": hashed(8), "c[*].id": hashed(64, "other")}
    compiled = compile_filter(LAYOUT, filter_rules(rules), KEYS)
    expected = message(digest("Anna")[:16], digest("")[:8], digest("ß")[:8], c=digest("Anna", "other"))
    assert b"".join(compiled(message("Anna", "", "ß", c="Anna"))) == expected


def test_a_missing_key_refuses_the_filter() -> None:
    for keys in ({}, {"ward": bytes(31)}):
        with pytest.raises(FilterRefused, match="a: the publisher has no key 'ward' of 32 bytes"):
            compile_filter(LAYOUT, filter_rules({"a": hashed()}), keys)


def test_without_keys_rules_are_checked_and_messages_refused() -> None:
    compiled = compile_filter(LAYOUT, filter_rules({"a": hashed()}))
    with pytest.raises(MessageRefused):
        compiled(message("Anna"))


@pytest.mark.parametrize("name", ["", "A", "1a", "a/b", "..", "a" * 33, "ä", "a\n", 1, None])
def test_invalid_key_names_are_refused(name: object) -> None:
    with pytest.raises(FilterRefused, match="not a key name"):
        check_key_name(name)
    with pytest.raises(FilterRefused, match="not a key name"):
        pseudonyms(name, 8, KEYS)
    assert check_key_name("ward-3_b") == "ward-3_b"


def test_key_names_of_rules() -> None:
    rules = filter_rules({"a": hashed(), "b": hashed(key="other"), "c": {"redact": {"text": "x"}}})
    assert key_names(rules) == {"ward", "other"}


def test_pseudonyms_of_two_receivers_have_nothing_in_common() -> None:
    """The key is HMAC(key, "rossec-pseudonym-receiver" 00 || thumbprint)."""
    rules = filter_rules({"a": {"hash": {"key": "ward", "per": "receiver"}}, "b": hashed()})
    seen = []
    for receiver in (bytes(32), bytes([1]) * 32):
        compiled = compile_filter(LAYOUT, rules, receiver_keys(KEYS, receiver))
        derived = hmac.digest(KEYS["ward"], b"rossec-pseudonym-receiver\0" + receiver, "sha256")
        own = hmac.new(derived, b"Anna", hashlib.sha256).hexdigest()[:16]
        expected = message(own, digest("Anna")[:16], c="x")
        assert b"".join(compiled(message("Anna", "Anna", c="x"))) == expected
        seen.append(own)
    assert seen[0] != seen[1]


def test_without_a_receiver_there_is_no_pseudonym_of_its_own() -> None:
    rules = filter_rules({"a": {"hash": {"key": "ward", "per": "receiver"}}})
    for keys in (KEYS, receiver_keys({"ward": bytes(31)}, bytes(32))):
        with pytest.raises(FilterRefused, match="the publisher has no key 'ward'"):
            compile_filter(LAYOUT, rules, keys)


def test_rules_that_differ_by_receiver() -> None:
    assert not is_personal(filter_rules({"a": hashed(), "b": {"clear": True}}))
    assert is_personal(filter_rules({"a": {"hash": {"key": "ward", "per": "receiver"}}}))

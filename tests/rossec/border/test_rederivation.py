"""Contexts of a secret: both sides contribute, and what is repeated makes nothing new."""

import aiocoap
import pytest

from ca.encoding import encode
from rossec.border import messages
from rossec.border.messages import (
    LIFETIME,
    MAX_ID1,
    NONCE_SIZE,
    R2_SIZE,
    ContextChallenges,
    OscoreContext,
    border_context,
    is_in,
    thing_context,
    unwrapped,
    wrapped,
)
from rossec.errors import DatagramRefused

KEY, KID, NOW = bytes(range(16)), b"\x07", 12_345.678


def test_a_value_is_in_a_kid_context_as_a_byte_string() -> None:
    for size in (NONCE_SIZE, R2_SIZE + NONCE_SIZE, MAX_ID1):
        assert unwrapped(wrapped(bytes(size))) == bytes(size)


@pytest.mark.parametrize(
    "kid_context",
    [
        b"",
        b"abc",
        encode("12345678"),
        encode(1),
        wrapped(bytes(NONCE_SIZE - 1)),
        wrapped(bytes(MAX_ID1 + 1)),
        wrapped(bytes(8)) + b"\0",
        b"\x58\x08" + bytes(8),
    ],
)
def test_other_kid_contexts_are_refused(kid_context: bytes) -> None:
    with pytest.raises(DatagramRefused, match="kid context"):
        unwrapped(kid_context)


def test_a_challenge_is_recognized_for_a_while() -> None:
    challenges = ContextChallenges(KEY)
    value = challenges.make(KID, NOW, b"ab")
    assert len(value) == R2_SIZE
    made = int(NOW * 1000)
    assert challenges.issued(KID, value + bytes(NONCE_SIZE), NOW) == made
    assert challenges.issued(KID, value, NOW + LIFETIME / 1000 - 0.1) == made
    assert challenges.issued(KID, value, NOW + LIFETIME / 1000 + 0.1) == 0


def test_a_challenge_is_of_one_thing_and_one_process() -> None:
    value = ContextChallenges(KEY).make(KID, NOW, b"ab")
    assert ContextChallenges(KEY).issued(b"\x08", value, NOW) == 0
    assert ContextChallenges(bytes(16)).issued(KID, value, NOW) == 0
    for at in range(R2_SIZE):
        changed = value[:at] + bytes([value[at] ^ 1]) + value[at + 1 :]
        assert ContextChallenges(KEY).issued(KID, changed, NOW) == 0
    assert ContextChallenges(KEY).issued(KID, b"", NOW) == 0


def test_both_sides_derive_the_same_from_the_same() -> None:
    border, thing = (make(KEY, KID, bytes(8)) for make in (border_context, thing_context))
    sealed, _ = thing.seal(aiocoap.Message(code=aiocoap.POST, payload=b"here"))
    sealed.mtype, sealed.mid, sealed.token = messages.CON, 1, b""
    data = messages.write(sealed)
    assert border.open(messages.read(data))[0].payload == b"here"
    for other in (border_context(KEY, KID, bytes(9)), border_context(bytes(16), KID, bytes(8))):
        with pytest.raises(DatagramRefused):
            other.open(messages.read(data))


def test_a_challenge_is_answered_once_and_only_the_newest() -> None:
    challenges = ContextChallenges(KEY)
    older, newer = (challenges.make(KID, NOW + each, b"ab") for each in (0, 1))
    assert not challenges.take(KID, newer, NOW + 2)  # no R3
    assert challenges.take(KID, newer + bytes(NONCE_SIZE), NOW + 2)
    for value in (newer + bytes(NONCE_SIZE), newer + b"another!", older + bytes(NONCE_SIZE)):
        assert not challenges.take(KID, value, NOW + 2)
    assert challenges.take(b"\x08", challenges.make(b"\x08", NOW, b"ab") + bytes(8), NOW + 2)


def test_a_request_is_in_the_context_that_it_names() -> None:
    context = border_context(KEY, KID, bytes(24))
    assert is_in(context, None)
    assert is_in(context, wrapped(bytes(24)))
    assert not is_in(context, wrapped(b"R" * 24))
    assert not is_in(OscoreContext(KEY, b"", b"", KID), wrapped(bytes(24)))

"""OSCORE contexts: one role or the other, no message twice, no key of another."""

import aiocoap
import pytest

from rossec.border import messages
from rossec.border.messages import OscoreContext, name_context, unprotected
from rossec.errors import DatagramRefused

SECRET, SALT = bytes(range(16)), bytes(8)


def pair(secret: bytes = SECRET) -> tuple[OscoreContext, OscoreContext]:
    return OscoreContext(SECRET, SALT, b"a", b"b"), OscoreContext(secret, SALT, b"b", b"a")


def over_the_wire(message: aiocoap.Message) -> aiocoap.Message:
    message.mtype, message.mid, message.token = messages.CON, 1, b"t"
    return messages.read(messages.write(message))


def request() -> aiocoap.Message:
    return aiocoap.Message(code=aiocoap.POST, uri_path=("rd",), payload=b"here")


def test_requests_and_answers_in_both_directions() -> None:
    for first, second in (pair(), pair()[::-1]):
        sealed, asked = first.seal(request())
        arrived = over_the_wire(sealed)
        assert b"here" not in arrived.payload
        assert unprotected(arrived) == (first.sender_id, None)
        opened, identifier = second.open(arrived)
        assert (opened.payload, opened.opt.uri_path) == (b"here", ("rd",))
        answer, _ = second.seal(aiocoap.Message(code=aiocoap.CHANGED, payload=b"ok"), identifier)
        found, _ = first.open(over_the_wire(answer), asked)
        assert (found.code, found.payload) == (aiocoap.CHANGED, b"ok")


def test_a_request_is_taken_once() -> None:
    first, second = pair()
    data = over_the_wire(first.seal(request())[0])
    second.open(data)
    with pytest.raises(DatagramRefused, match="ReplayError"):
        second.open(data)


def test_a_request_that_was_changed_or_of_another_key_is_refused() -> None:
    first, second = pair()
    arrived = over_the_wire(first.seal(request())[0])
    for at in range(len(arrived.payload)):
        payload = bytearray(arrived.payload)
        payload[at] ^= 1
        changed = arrived.copy(payload=bytes(payload))
        changed.direction = arrived.direction
        with pytest.raises(DatagramRefused):
            second.open(changed)
    _, other = pair(bytes(16))
    with pytest.raises(DatagramRefused, match="not protected by this key"):
        other.open(arrived)
    second.open(arrived)


def test_both_sides_have_names_of_their_own() -> None:
    with pytest.raises(DatagramRefused, match="the same ID"):
        OscoreContext(SECRET, SALT, b"a", b"a")


def test_a_message_without_protection_or_kid() -> None:
    with pytest.raises(DatagramRefused, match="not protected"):
        unprotected(over_the_wire(request()))
    first, _ = pair()
    sealed = over_the_wire(first.seal(request())[0])
    sealed.opt.oscore = b"\x01\x00"  # a sequence number, no kid
    with pytest.raises(DatagramRefused, match="without a kid"):
        unprotected(sealed)
    sealed.opt.oscore = b"\xff"
    with pytest.raises(DatagramRefused):
        unprotected(sealed)


def test_a_kid_context_is_named_outside_of_what_is_sealed() -> None:
    first, second = pair()
    sealed, _ = first.seal(request())
    name_context(sealed, b"\x43abc")
    arrived = over_the_wire(sealed)
    assert unprotected(arrived) == (b"a", b"\x43abc")
    opened, _ = second.open(arrived)
    assert opened.payload == b"here"


def test_a_kid_context_that_ends_early_is_refused() -> None:
    first, second = pair()
    sealed = over_the_wire(first.seal(request())[0])
    sealed.opt.oscore = b"\x11\x00\x09ab"
    with pytest.raises(DatagramRefused):
        second.open(sealed)

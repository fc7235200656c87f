"""The test vectors of RFC 8613 appendix C, as a border router's contexts make them.

aiocoap does the derivation and the protection; which octets go where is decided here too.
"""

from typing import Any

import pytest
from aiocoap import Message
from aiocoap.numbers import codes

from rossec.border import messages
from rossec.border.messages import OscoreContext, name_context, unprotected

SECRET = bytes.fromhex("0102030405060708090a0b0c0d0e0f10")
SALT = bytes.fromhex("9e7ca92223786340")
ID_CONTEXT = bytes.fromhex("37cbf3210017a2d3")
REQUEST = "44015d1f00003974396c6f63616c686f737483747631"
ANSWER = "64455d1f00003974ff48656c6c6f20576f726c6421"


def context(sender: bytes, recipient: bytes, **changes: Any) -> OscoreContext:
    given: dict[str, Any] = {"secret": SECRET, "salt": SALT, "id_context": None} | changes
    return OscoreContext(given["secret"], given["salt"], sender, recipient, given["id_context"])


@pytest.mark.parametrize(
    ("sender", "recipient", "changes", "sender_key", "recipient_key", "common_iv"),
    [
        (
            b"",
            b"\x01",
            {},
            "f0910ed7295e6ad4b54fc793154302ff",
            "ffb14e093c94c9cac9471648b4f98710",
            "4622d4dd6d944168eefb54987c",
        ),
        (
            b"\0",
            b"\x01",
            {"salt": b""},
            "321b26943253c7ffb6003b0b64d74041",
            "e57b5635815177cd679ab4bcec9d7dda",
            "be35ae297d2dace910c52e99f9",
        ),
        (
            b"",
            b"\x01",
            {"id_context": ID_CONTEXT},
            "af2a1300a5e95788b356336eeecd2b92",
            "e39a0c7c77b43f03b4b39ab9a268699f",
            "2ca58fb85ff1b81c0b7181b85e",
        ),
    ],
)
def test_derivation_of_keys(
    sender: bytes,
    recipient: bytes,
    changes: dict[str, Any],
    sender_key: str,
    recipient_key: str,
    common_iv: str,
) -> None:
    """C.1, C.2 and C.3, on both sides."""
    client, server = context(sender, recipient, **changes), context(recipient, sender, **changes)
    assert client.sender_key.hex() == server.recipient_key.hex() == sender_key
    assert client.recipient_key.hex() == server.sender_key.hex() == recipient_key
    assert client.common_iv.hex() == server.common_iv.hex() == common_iv


@pytest.mark.parametrize(
    ("sender", "recipient", "changes", "expected"),
    [
        (b"", b"\x01", {}, ("44025d1f00003974396c6f63616c686f7374620914ff612f1092f1776f1c1668b3825e")),
        (
            b"\0",
            b"\x01",
            {"salt": b""},
            ("44025d1f00003974396c6f63616c686f737463091400ff4ed339a5a379b0b8bc731fffb0"),
        ),
        (
            b"",
            b"\x01",
            {"id_context": ID_CONTEXT},
            ("44025d1f00003974396c6f63616c686f73746b19140837cbf3210017a2d3ff72cd7273fd331ac45cffbe55c3"),
        ),
    ],
)
def test_a_protected_request(sender: bytes, recipient: bytes, changes: dict[str, Any], expected: str) -> None:
    """C.4, C.5 and C.6; the last names its context as `rederivation` does."""
    client, server = context(sender, recipient, **changes), context(recipient, sender, **changes)
    client.sender_sequence_number = 20
    plain = messages.read(bytes.fromhex(REQUEST))
    request = Message(code=plain.code, uri_host=plain.opt.uri_host, uri_path=plain.opt.uri_path)
    sealed, _ = client.seal(request)
    if "id_context" in changes:
        name_context(sealed, ID_CONTEXT)
    sealed.mtype, sealed.mid, sealed.token = plain.mtype, plain.mid, plain.token
    assert messages.write(sealed).hex() == expected
    received = messages.read(bytes.fromhex(expected))
    assert unprotected(received) == (sender, changes.get("id_context"))
    opened, _ = server.open(received)
    assert (opened.code, opened.opt.uri_path) == (codes.GET, ("tv1",))


@pytest.mark.parametrize(
    ("reused", "expected"),
    [
        (True, "64445d1f0000397490ffdbaad1e9a7e7b2a813d3c31524378303cdafae119106"),
        (False, "64445d1f00003974920100ff4d4c13669384b67354b2b6175ff4b8658c666a6cf88e"),
    ],
)
def test_a_protected_answer(reused: bool, expected: str) -> None:
    """C.7 and C.8: with the nonce of the request, and with one of its own."""
    client, server = context(b"", b"\x01"), context(b"\x01", b"")
    client.sender_sequence_number = 20
    sealed, identifier = client.seal(Message(code=codes.GET, uri_path=("tv1",)))
    sealed.mtype, sealed.mid, sealed.token = messages.CON, 1, b""
    _, asked = server.open(messages.read(messages.write(sealed)))
    asked.can_reuse_nonce = reused
    plain = messages.read(bytes.fromhex(ANSWER))
    answer, _ = server.seal(Message(code=plain.code, payload=plain.payload), asked)
    answer.mtype, answer.mid, answer.token = plain.mtype, plain.mid, plain.token
    assert messages.write(answer).hex() == expected
    opened, _ = client.open(messages.read(bytes.fromhex(expected)), identifier)
    assert (opened.code, opened.payload) == (codes.CONTENT, b"Hello World!")

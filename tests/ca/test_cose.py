import itertools

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ca.encoding import Value, encode
from ca.errors import EncodingError, SignatureError
from ca.keys.signing import Profile
from tests.support.pki import new_signer

PROFILE, OTHER = Profile("rossec-test+cwt"), Profile("rossec-other+cwt")
SIGNER = new_signer()
KEY = SIGNER.public_key
GOOD = PROFILE.sign(SIGNER, {1: "a", 2: b"b"})


def frame(*parts: Value) -> bytes:
    return b"\xd2" + encode([*parts])


@settings(max_examples=50)
@given(st.dictionaries(st.integers(0, 100), st.binary() | st.integers(0, 9) | st.booleans()))
def test_round_trip(payload: dict[int | str, Value]) -> None:
    data = PROFILE.sign(SIGNER, payload)
    assert PROFILE.open(data, KEY) == payload
    assert PROFILE.peek(data) == payload


def test_the_protected_header_is_one_constant() -> None:
    assert PROFILE.protected.hex() == "a3012602811010" + "6f" + b"rossec-test+cwt".hex()
    assert GOOD[1:4] == b"\x84\x57\xa3"


def test_the_signature_is_over_the_sig_structure() -> None:
    """Rebuilt by hand from RFC 9052 section 4.4."""
    body = encode({1: "a", 2: b"b"})
    message = encode(["Signature1", PROFILE.protected, b"", body])
    assert PROFILE.open(frame(PROFILE.protected, {}, body, SIGNER.sign(message)), KEY) == {1: "a", 2: b"b"}


def test_every_byte_counts() -> None:
    for position, change in itertools.product(range(len(GOOD)), (0x01, 0x20, 0x80, 0xFF)):
        damaged = bytearray(GOOD)
        damaged[position] ^= change
        with pytest.raises((SignatureError, EncodingError)):
            PROFILE.open(bytes(damaged), KEY)


def test_truncation_and_tail() -> None:
    for damaged in [*(GOOD[:size] for size in range(len(GOOD))), GOOD + b"\0"]:
        with pytest.raises((SignatureError, EncodingError)):
            PROFILE.open(damaged, KEY)


def test_one_kind_is_not_taken_for_another() -> None:
    with pytest.raises(SignatureError, match=r"not a statement of kind rossec-other\+cwt"):
        OTHER.open(GOOD, KEY)
    with pytest.raises(SignatureError, match="not a statement of kind"):
        OTHER.peek(GOOD)


def test_another_key_does_not_verify() -> None:
    with pytest.raises(SignatureError, match="the signature does not verify"):
        PROFILE.open(GOOD, new_signer().public_key)


BODY, SIGNATURE = encode(1), bytes(64)


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (b"", "not a COSE_Sign1 statement"),
        (GOOD[1:], "not a COSE_Sign1 statement"),
        (b"\xd1" + GOOD[1:], "not a COSE_Sign1 statement"),
        (b"\xd2" + encode(1), "not a COSE_Sign1 statement"),
        (frame(PROFILE.protected, {}, BODY), "not a COSE_Sign1 statement"),
        (frame(PROFILE.protected, {}, BODY, SIGNATURE, 0), "not a COSE_Sign1 statement"),
        (frame(PROFILE.protected, [], BODY, SIGNATURE), "not a COSE_Sign1 statement"),
        (frame(PROFILE.protected, {}, None, SIGNATURE), "not a COSE_Sign1 statement"),
        (frame(PROFILE.protected, {}, BODY, "x" * 64), "not a COSE_Sign1 statement"),
        (frame(PROFILE.protected, {4: b"kid"}, BODY, SIGNATURE), "with an unprotected header"),
        (frame(b"", {}, BODY, SIGNATURE), "not a statement of kind"),
        (frame(encode({1: -7}), {}, BODY, SIGNATURE), "not a statement of kind"),
        (frame(PROFILE.protected, {}, BODY, bytes(63)), "signature of a wrong length"),
        (frame(PROFILE.protected, {}, BODY, bytes(65)), "signature of a wrong length"),
        (frame(PROFILE.protected, {}, BODY, SIGNATURE), "the signature does not verify"),
        (frame(PROFILE.protected, {}, BODY, b"\xff" * 64), "the signature does not verify"),
    ],
)
def test_frames_that_are_wrong(data: bytes, message: str) -> None:
    with pytest.raises(SignatureError, match=message):
        PROFILE.open(data, KEY)


def test_signed_but_not_deterministic() -> None:
    body = b"\x18\x01"
    signature = SIGNER.sign(encode(["Signature1", PROFILE.protected, b"", body]))
    with pytest.raises(EncodingError, match="not in its deterministic form"):
        PROFILE.open(frame(PROFILE.protected, {}, body, signature), KEY)


def test_size_comes_first() -> None:
    with pytest.raises(EncodingError, match="bytes of CBOR where at most 10"):
        PROFILE.open(GOOD, KEY, limit=10)
    with pytest.raises(EncodingError, match="bytes of CBOR where at most 10"):
        PROFILE.peek(GOOD, limit=10)


@pytest.mark.parametrize("size", [0, 1, 22, 23, 24, 253, 254, 255, 256, 65533, 65534, 70000])
def test_every_length_of_payload(size: int) -> None:
    payload = bytes(size)
    data = PROFILE.sign(SIGNER, payload)
    assert data[1:] == encode([PROFILE.protected, {}, encode(payload), data[-64:]])
    assert PROFILE.open(data, KEY, limit=1 << 17) == payload
    assert PROFILE.open_body(data, KEY, limit=1 << 17) == encode(payload)
    assert PROFILE.peek_body(data, limit=1 << 17) == encode(payload)


def test_long_heads_are_refused() -> None:
    """The payload's and the signature's length, each in a longer form."""
    start = len(b"\xd2\x84" + encode(PROFILE.protected) + b"\xa0")
    body = encode({1: "a", 2: b"b"})
    for longer in (
        GOOD[:start] + b"\x58" + bytes([len(body)]) + GOOD[start + 1 :],
        GOOD[:-66] + b"\x59\x00\x40" + GOOD[-64:],
    ):
        with pytest.raises(EncodingError, match="not in its deterministic form"):
            PROFILE.open(longer, KEY)


@pytest.mark.parametrize("payload", [[b"x" * 32], {}, [b"x" * 32, b"y" * 32, "/name"], b"z" * 300])
def test_a_statement_whose_payload_is_known_is_compared_and_not_decoded(payload: Value) -> None:
    data = PROFILE.sign(SIGNER, payload)
    PROFILE.check(data, KEY, payload)
    changed = [data[:at] + bytes([data[at] ^ 1]) + data[at + 1 :] for at in range(len(data))]
    for other in [*changed, *(data[:end] for end in range(len(data))), data + b"\0"]:
        with pytest.raises(SignatureError):
            PROFILE.check(other, KEY, payload)
    for profile, key, stated in (
        (OTHER, KEY, payload),
        (PROFILE, new_signer().public_key, payload),
        (PROFILE, KEY, 7),
    ):
        with pytest.raises(SignatureError):
            profile.check(data, key, stated)


class Recorder:
    """A signer that keeps what it is asked to sign."""

    public_key = KEY
    message = b""

    def sign(self, message: bytes) -> bytes:
        self.message = message
        return SIGNER.sign(message)


@pytest.mark.parametrize("payload", [{}, {1: "a", 2: b"b"}, {1: b"x" * 300}])
def test_what_is_to_be_signed_is_read_before(payload: dict[int | str, Value]) -> None:
    recorder = Recorder()
    PROFILE.sign(recorder, payload)
    assert PROFILE.payload_to_sign(recorder.message) == payload
    with pytest.raises(SignatureError, match="not a statement of kind rossec-other"):
        OTHER.payload_to_sign(recorder.message)
    cut = [recorder.message[:size] for size in range(len(recorder.message))]
    for changed in [*cut, recorder.message + b"\0"]:
        with pytest.raises((SignatureError, EncodingError)):
            PROFILE.payload_to_sign(changed)


def test_what_is_to_be_signed_must_be_deterministic_and_bounded() -> None:
    recorder = Recorder()
    PROFILE.sign(recorder, {1: "a"})
    beginning = recorder.message[: -1 - len(encode({1: "a"}))]
    for body in (b"\xff", b"\xa1\x18\x01\x61a"):
        with pytest.raises(EncodingError):
            PROFILE.payload_to_sign(beginning + encode(body))
    with pytest.raises(EncodingError, match="at most 3"):
        PROFILE.payload_to_sign(recorder.message, limit=3)

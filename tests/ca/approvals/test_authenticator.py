import hashlib

import pytest
from cryptography.hazmat.primitives.asymmetric import ec

from ca.approvals.passkeys import MAX_AUTHENTICATOR_DATA, AuthenticatorData, read_key
from ca.encoding import encode
from ca.errors import ApprovalRefused
from tests.support.passkeys import AT, BE, BS, ED, RP_ID, UP, UV, Passkey

PARTY = hashlib.sha256(RP_ID.encode()).digest()


def data(flags: int = UP | UV, more: bytes = b"") -> bytes:
    return PARTY + bytes([flags]) + (7).to_bytes(4) + more


def test_the_fixed_beginning_is_read() -> None:
    assert AuthenticatorData.read(data()) == (PARTY, UP | UV, 7)
    AuthenticatorData.read(data(UP | UV | BE | BS)).check(RP_ID)
    AuthenticatorData.read(data(UP | UV | ED, b"\xa0")).check(RP_ID)


@pytest.mark.parametrize("flags", [0, UP, UV, BE | BS | ED | AT | UV])
def test_a_user_who_was_not_verified_is_refused(flags: int) -> None:
    more = b"x" if flags & (AT | ED) else b""
    with pytest.raises(ApprovalRefused, match="without a finger, face or PIN"):
        AuthenticatorData.read(data(flags, more)).check(RP_ID)


def test_another_relying_party_is_refused() -> None:
    with pytest.raises(ApprovalRefused, match=r"does not belong to rossec\.local"):
        AuthenticatorData.read(data()).check("rossec.local")


@pytest.mark.parametrize(
    "wrong",
    [
        *(data()[:size] for size in range(37)),
        data(more=b"x"),
        data(UP | UV | ED),
        data(UP | UV | ED, bytes(MAX_AUTHENTICATOR_DATA)),
    ],
)
def test_data_of_another_length_is_refused(wrong: bytes) -> None:
    with pytest.raises(ApprovalRefused, match="authenticator data"):
        AuthenticatorData.read(wrong)


def test_an_es256_key_is_read() -> None:
    device = Passkey()
    assert read_key(device.cose_key) == device.key.public_key()


NUMBERS = ec.generate_private_key(ec.SECP256R1()).public_key().public_numbers()
X, Y = NUMBERS.x.to_bytes(32), NUMBERS.y.to_bytes(32)


@pytest.mark.parametrize(
    "key",
    [
        {1: 2, 3: -7, -1: 1, -2: X},
        {1: 2, 3: -8, -1: 1, -2: X, -3: Y},
        {1: 2, 3: -7, -1: 2, -2: X, -3: Y},
        {1: 1, 3: -7, -1: 1, -2: X, -3: Y},
        {1: 2, 3: -7, -1: 1, -2: X, -3: Y, 4: 1},
        {1: 2, 3: -7, -1: 1, -2: X + b"\0", -3: Y},
        {1: 2, 3: -7, -1: 1, -2: X, -3: True},
        {1: 2, 3: -7, -1: 1, -2: X, -3: bytes(32)},
        [X, Y],
    ],
)
def test_any_other_key_is_refused(key: object) -> None:
    with pytest.raises(ApprovalRefused, match="the device's key is not"):
        read_key(encode(key))  # type: ignore[arg-type]


def test_a_key_that_is_not_deterministic_is_refused() -> None:
    with pytest.raises(ApprovalRefused, match="not a key of P-256"):
        read_key(Passkey().cose_key + b"\0")

"""Signed lists and what a node knows from them, for the tests of `ca.revocation.trust_status`."""

import pytest
from cryptography.hazmat.primitives.asymmetric.utils import encode_dss_signature

from ca.revocation.lists import MAX_AGE, RevocationList, Timestamp, digest, sign_list
from ca.revocation.trust_status import Revocations
from tests.support.pki import NOW, new_signer

SIGNER = new_signer()
A, B, KEY = b"a" * 16, b"b" * 16, b"k" * 32
LIFE = 86_400
# The order of P-256: (r, n - s) is the second valid form of the signature (r, s).
N = 0xFFFFFFFF00000000FFFFFFFFFFFFFFFFBCE6FAADA7179E84F3B9CAC2FC632551


def signed(seq: int, *entries: bytes, epoch: int = 1, issued: int = NOW) -> bytes:
    return sign_list(SIGNER, RevocationList(epoch, seq, issued, issued + LIFE, frozenset(entries)))


def stamp(seq: int, data: bytes, issued: int = NOW, max_age: int = MAX_AGE) -> Timestamp:
    return Timestamp(seq, digest(data), issued, max_age)


def fresh(*entries: bytes) -> Revocations:
    state = Revocations(SIGNER.public_key)
    data = signed(1, *entries)
    state.update(data, NOW)
    state.confirm(stamp(1, data), NOW)
    return state


def never(_: bytes) -> None:
    pytest.fail("nothing to persist")


def twisted(data: bytes) -> bytes:
    """The same list with the other valid signature: ECDSA is malleable."""
    r, s = data[-64:-32], int.from_bytes(data[-32:])
    assert encode_dss_signature(int.from_bytes(r), s)
    return data[:-64] + r + (N - s).to_bytes(32)

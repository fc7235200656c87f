"""The key exchanges and signatures of the table, each by itself and against the library."""

import hashlib
from dataclasses import dataclass

import pytest
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric import ec, ed25519
from cryptography.hazmat.primitives.asymmetric.utils import decode_dss_signature

from rossec.channel.connection import Connection
from rossec.channel.edhoc.credentials import Credentials
from rossec.channel.edhoc.handshake import EdhocConfig
from rossec.channel.edhoc.suites import HYBRID, OFFERED_SUITES, POST_QUANTUM, SUITES
from rossec.channel.negotiation import ConnectionState
from rossec.errors import HandshakeFailed
from tests.support.wire import NOT_AFTER, NOW, dice, receive


@pytest.mark.parametrize("number", SUITES)
def test_both_sides_of_an_exchange_agree(number: int) -> None:
    exchange = SUITES[number].exchange
    finish, g_x = exchange.start(dice("a"))
    g_y, shared = exchange.answer(dice("b"), g_x)
    assert finish(g_y) == shared
    assert len(g_x) == exchange.initiator_length
    assert len(g_y) == exchange.responder_length
    assert len(shared) == (64 if number == HYBRID else 32)


def test_p256_with_x_coordinates_agrees_with_the_library() -> None:
    finish, _ = SUITES[2].exchange.start(dice("a"))
    other = ec.generate_private_key(ec.SECP256R1())
    x = other.public_key().public_numbers().x.to_bytes(32)
    shared = finish(x)
    _, again = SUITES[2].exchange.answer(dice("a"), x)
    assert shared == again  # whichever of the two points the sender had


def test_a_point_that_is_not_on_the_curve() -> None:
    finish, _ = SUITES[2].exchange.start(dice("a"))
    with pytest.raises(HandshakeFailed, match="usable point"):
        finish(b"\xff" * 32)


def test_an_ml_kem_key_out_of_range() -> None:
    with pytest.raises(HandshakeFailed, match="ML-KEM"):
        SUITES[HYBRID].exchange.answer(dice("a"), b"\xff" * 1216)


def test_the_hybrid_secret_needs_both_halves() -> None:
    exchange = SUITES[HYBRID].exchange
    _, g_x = exchange.start(dice("a"))
    other, _ = exchange.start(dice("c"))
    g_y, shared = exchange.answer(dice("b"), g_x)
    assert other(g_y)[:32] != shared[:32]
    assert other(g_y)[32:] != shared[32:]


def test_an_x25519_point_of_low_order() -> None:
    with pytest.raises(HandshakeFailed, match="usable point"):
        SUITES[4].exchange.answer(dice("a"), bytes(32))


def test_a_signature_is_of_the_suites_kind_and_the_message() -> None:
    p256, other = ec.generate_private_key(ec.SECP256R1()), ec.generate_private_key(ec.SECP384R1())
    edwards = ed25519.Ed25519PrivateKey.generate()
    es256 = es256_signature(p256, b"message")
    eddsa = edwards.sign(b"message")
    SUITES[6].verify(p256.public_key(), es256, b"message")
    SUITES[4].verify(edwards.public_key(), eddsa, b"message")
    for number, key, signature in ((6, p256.public_key(), es256), (4, edwards.public_key(), eddsa)):
        with pytest.raises(HandshakeFailed, match="signature does not verify"):
            SUITES[number].verify(key, signature, b"another message")
    for wrong in (edwards.public_key(), other.public_key()):
        with pytest.raises(HandshakeFailed, match="not a P-256 key"):
            SUITES[6].verify(wrong, es256, b"message")
    with pytest.raises(HandshakeFailed, match="not an Ed25519 key"):
        SUITES[4].verify(p256.public_key(), eddsa, b"message")


def es256_signature(key: ec.EllipticCurvePrivateKey, message: bytes) -> bytes:
    r, s = decode_dss_signature(key.sign(message, ec.ECDSA(hashes.SHA256())))
    return r.to_bytes(32) + s.to_bytes(32)


def test_the_policies() -> None:
    assert OFFERED_SUITES == (6,)
    assert POST_QUANTUM == {"off": (6,), "prefer": (HYBRID, 6), "require": (HYBRID,)}


@dataclass(frozen=True)
class Edwards:
    """An Ed25519 identity; its certificate is its public key."""

    key: ed25519.Ed25519PrivateKey
    not_after: int = NOT_AFTER

    @property
    def public_key(self) -> ed25519.Ed25519PublicKey:
        return self.key.public_key()

    @property
    def credentials(self) -> Credentials:
        return Credentials(self, (self.public_key.public_bytes_raw(),))  # type: ignore[arg-type]  # signs like one

    def sign(self, message: bytes) -> bytes:
        return self.key.sign(message)


def edwards(name: str) -> Edwards:
    seed = hashlib.sha256(name.encode()).digest()
    return Edwards(ed25519.Ed25519PrivateKey.from_private_bytes(seed))


@dataclass(frozen=True)
class EdwardsPeer:
    public_key: ed25519.Ed25519PublicKey
    not_after: int = NOT_AFTER


def verify(chain: tuple[bytes, ...], _: int) -> EdwardsPeer:
    return EdwardsPeer(ed25519.Ed25519PublicKey.from_public_bytes(chain[0]))


def test_suite_4_from_the_opening_to_a_record() -> None:
    ours = EdhocConfig(edwards("a").credentials, verify, dice("a"), suites=(4,))
    theirs = EdhocConfig(edwards("b").credentials, verify, dice("b"), suites=(4,))
    left = Connection[EdwardsPeer].initiator(ours, now=NOW)
    right = Connection[EdwardsPeer].responder(theirs, now=NOW)
    for _ in range(2):
        receive(right, left.data_to_send(), NOW)
        receive(left, right.data_to_send(), NOW)
    assert left.state is ConnectionState.OPEN
    left.send_unit(b"x" * 300_000)
    assert len(receive(right, left.data_to_send(), NOW)) == 1

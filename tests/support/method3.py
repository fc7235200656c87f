"""EDHOC method 3 (static Diffie-Hellman), suite 2, credentials by kid: for tests alone.

lakers, the independent implementation on PyPI, supports only this. The transcript, key schedule,
messages, P-256 exchange and AEAD are the production code; only the differences are here.
"""

from dataclasses import dataclass
from functools import partial

from cryptography.hazmat.primitives.asymmetric import ec

from ca.encoding import decode_sequence, encode
from rossec.channel.edhoc.messages import Message1, decode_bytes, decode_message_1
from rossec.channel.edhoc.suites import (
    GONE,
    SUITES,
    EdhocExporter,
    Finish,
    KdfLabel,
    Random,
    Secret,
    _p256,
    bstr,
    extract,
    kdf,
    transcript_2,
    transcript_next,
)

SUITE = SUITES[2]
SALT_3E2M, SALT_4E3M, MAC_LENGTH = 1, 5, 8


@dataclass(frozen=True)
class Static:
    """A static key, its kid (one byte, a small CBOR integer), its CCS as encoded."""

    key: ec.EllipticCurvePrivateKey | ec.EllipticCurvePublicKey
    kid: bytes
    cred: bytes

    @property
    def id_cred(self) -> bytes:
        return encode({4: self.kid})

    @property
    def x(self) -> bytes:
        key = self.key
        public = key.public_key() if isinstance(key, ec.EllipticCurvePrivateKey) else key
        return public.public_numbers().x.to_bytes(32)

    def exchange(self, peer: bytes) -> bytes:
        assert isinstance(self.key, ec.EllipticCurvePrivateKey)
        return _p256(self.key, peer)


def scalar(private: bytes) -> ec.EllipticCurvePrivateKey:
    return ec.derive_private_key(int.from_bytes(private), ec.SECP256R1())


def fixed(private: bytes) -> Random:
    """Randomness that makes `P256Exchange` choose this private key."""
    return (int.from_bytes(private) - 1).to_bytes


class Method3:
    """Either side; call the methods in the order of the messages."""

    def __init__(self, own: Static, peer: Static, random: Random) -> None:
        self.own, self.peer, self.random = own, peer, random
        self.finish: Finish = lambda _: b""
        self.message, self.g_x, self.g_y, self.c_r = b"", b"", b"", b""
        self.th, self.prk = b"", GONE

    @property
    def exporter(self) -> EdhocExporter:
        return EdhocExporter.derive(self.prk, self.th)

    # -- message_1 and message_2

    def make_1(self, c_i: bytes = b"\x0e", suites: tuple[int, ...] = (2,)) -> bytes:
        self.finish, self.g_x = SUITE.exchange.start(self.random)
        self.message = Message1(3, suites, self.g_x, c_i).encode()
        return self.message

    def take_1(self, data: bytes) -> None:
        parsed = decode_message_1(data)
        assert parsed.method == 3
        assert parsed.suites[-1] == 2
        self.message, self.g_x = data, parsed.g_x

    def make_2(self, c_r: bytes = b"\x27", ead: bytes = b"") -> bytes:
        self.c_r = c_r
        self.finish, self.g_y = SUITE.exchange.start(self.random)
        self._agree(self.finish(self.g_x))
        prk_2e, th_2 = self.prk, self.th
        self._mix(SALT_3E2M, self.own.exchange(self.g_x))
        plaintext = c_r + self.own.kid + bstr(self._mac(KdfLabel.MAC_2, c_r, self.own, ead)) + ead
        self.th = transcript_next(th_2, plaintext, self.own.cred)
        return bstr(self.g_y + _xor(plaintext, kdf(prk_2e, KdfLabel.KEYSTREAM_2, th_2, len(plaintext))))

    def take_2(self, data: bytes) -> None:
        body = decode_bytes(data)
        self.g_y, ciphertext = body[:32], body[32:]
        self._agree(self.finish(self.g_y))
        plaintext = _xor(ciphertext, kdf(self.prk, KdfLabel.KEYSTREAM_2, self.th, len(ciphertext)))
        c_r, kid, mac, *ead = decode_sequence(plaintext)
        self.c_r = encode(c_r)
        assert encode(kid) == self.peer.kid
        self._mix(SALT_3E2M, self.finish(self.peer.x))
        tail = b"".join(map(encode, ead))
        assert mac == self._mac(KdfLabel.MAC_2, self.c_r, self.peer, tail)
        self.th = transcript_next(self.th, plaintext, self.peer.cred)

    # -- message_3 and message_4

    def make_3(self, ead: bytes = b"") -> bytes:
        prk_3e2m, th_3 = self.prk, self.th
        self._mix(SALT_4E3M, self.own.exchange(self.g_y))
        plaintext = self.own.kid + bstr(self._mac(KdfLabel.MAC_3, b"", self.own, ead)) + ead
        self.th = transcript_next(th_3, plaintext, self.own.cred)
        return bstr(_aead(prk_3e2m, th_3, KdfLabel.K_3, KdfLabel.IV_3, "encrypt", plaintext))

    def take_3(self, data: bytes) -> None:
        ciphertext = decode_bytes(data)
        plaintext = _aead(self.prk, self.th, KdfLabel.K_3, KdfLabel.IV_3, "decrypt", ciphertext)
        kid, mac, *ead = decode_sequence(plaintext)
        assert encode(kid) == self.peer.kid
        self._mix(SALT_4E3M, self.finish(self.peer.x))
        tail = b"".join(map(encode, ead))
        assert mac == self._mac(KdfLabel.MAC_3, b"", self.peer, tail)
        self.th = transcript_next(self.th, plaintext, self.peer.cred)

    def make_4(self) -> bytes:
        return bstr(_aead(self.prk, self.th, KdfLabel.K_4, KdfLabel.IV_4, "encrypt", b""))

    def take_4(self, data: bytes) -> None:
        assert _aead(self.prk, self.th, KdfLabel.K_4, KdfLabel.IV_4, "decrypt", decode_bytes(data)) == b""

    # -- parts

    def _agree(self, shared: bytes) -> None:
        self.th = transcript_2(self.g_y, self.message)
        self.prk = extract(self.th, shared)

    def _mix(self, label: int, shared: bytes) -> None:
        self.prk = extract(kdf(self.prk, label, self.th, 32), shared)

    def _mac(self, label: KdfLabel, prefix: bytes, who: Static, ead: bytes) -> bytes:
        context = prefix + who.id_cred + bstr(self.th) + who.cred + ead
        return kdf(self.prk, label, context, MAC_LENGTH)


def _aead(prk: Secret, th: bytes, key: KdfLabel, iv: KdfLabel, operation: str, data: bytes) -> bytes:
    aead = SUITE.aead(kdf(prk, key, th, SUITE.key_length))
    run = partial(getattr(aead, operation), kdf(prk, iv, th, SUITE.nonce_length))
    result: bytes = run(data, encode(["Encrypt0", b"", th]))
    return result


def _xor(left: bytes, right: bytes) -> bytes:
    return bytes(a ^ b for a, b in zip(left, right, strict=True))

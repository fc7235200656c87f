"""The key schedule of EDHOC (RFC 9528 sections 4 and 5) with SHA-256, method 0.

With method 0 both sides authenticate by signature, so PRK_2e = PRK_3e2m = PRK_4e3m. Functions over
bytes only; which secret exists when is decided in `handshake`. Python cannot wipe bytes:
secrets are dropped as early as possible, no more is promised.
"""

import hashlib
from dataclasses import dataclass
from enum import IntEnum
from functools import cached_property
from typing import Final

from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.hmac import HMAC
from cryptography.hazmat.primitives.kdf.hkdf import HKDF, HKDFExpand

from ca.encoding import encode, head
from rossec.channel.edhoc.suites import HASH_LENGTH

_SHA256: Final = hashes.SHA256()


class KdfLabel(IntEnum):
    """Labels of EDHOC_KDF (RFC 9528, figure 6)."""

    KEYSTREAM_2 = 0
    MAC_2 = 2
    K_3 = 3
    IV_3 = 4
    MAC_3 = 6
    PRK_OUT = 7
    K_4 = 8
    IV_4 = 9
    PRK_EXPORTER = 10
    KEY_UPDATE = 11


class Secret:
    """A pseudorandom key; HMAC under it is set up once, which is half the cost of each use."""

    __slots__ = ("_hmac", "_key")

    def __init__(self, key: bytes) -> None:
        self._key = key
        self._hmac = HMAC(key, _SHA256)

    def expand(self, info: bytes, length: int) -> bytes:
        """EDHOC_Expand: HKDF-Expand, at most 8160 bytes."""
        if length > HASH_LENGTH:
            return HKDFExpand(_SHA256, length, info).derive(self._key)
        block = self._hmac.copy()  # one block alone: RFC 5869 section 2.3
        block.update(info + b"\x01")
        return block.finalize()[:length]


GONE: Final = Secret(b"")


def extract(salt: bytes, secret: bytes) -> Secret:
    """EDHOC_Extract: HKDF-Extract (RFC 5869)."""
    return Secret(HKDF.extract(_SHA256, salt, secret))


def bstr(data: bytes) -> bytes:
    """Encode a byte string: what `encode` gives, at a fifth of the cost for the usual ones."""
    length = len(data)
    if length < len(_SHORT):
        return _SHORT[length] + data
    return b"\x59" + length.to_bytes(2) + data if length < 65536 else encode(data)


_SHORT: Final = tuple(head(0x40, length) for length in range(256))


def kdf(prk: Secret, label: int, context: bytes, length: int) -> bytes:
    """EDHOC_KDF (RFC 9528 section 4.1.2)."""
    return prk.expand(_uint(label) + bstr(context) + _uint(length), length)


def _uint(value: int) -> bytes:
    return _SMALL[value] if value < len(_SMALL) else head(0, value)


_SMALL: Final = tuple(head(0, value) for value in range(256))


def transcript_2(g_y: bytes, message_1: bytes) -> bytes:
    """TH_2 = H( G_Y, H(message_1) ), over the bytes as they travelled."""
    digest = hashlib.sha256(message_1).digest()
    return hashlib.sha256(bstr(g_y) + bstr(digest)).digest()


def transcript_next(previous: bytes, plaintext: bytes, credential: bytes) -> bytes:
    """TH_3 and TH_4 = H( TH, PLAINTEXT, CRED ); `credential` is the encoded CRED_x."""
    return hashlib.sha256(bstr(previous) + plaintext + credential).digest()


def keystream_2(prk_2e: Secret, th_2: bytes, length: int) -> bytes:
    """The one-time pad over PLAINTEXT_2."""
    return kdf(prk_2e, KdfLabel.KEYSTREAM_2, th_2, length)


@dataclass(frozen=True)
class EdhocExporter:
    """The result of a finished handshake: PRK_out, and nothing older."""

    prk_out: bytes

    @cached_property
    def _prk_exporter(self) -> Secret:
        return Secret(kdf(Secret(self.prk_out), KdfLabel.PRK_EXPORTER, b"", HASH_LENGTH))

    @classmethod
    def derive(cls, prk_4e3m: Secret, th_4: bytes) -> "EdhocExporter":
        """PRK_out = EDHOC_KDF( PRK_4e3m, 7, TH_4, hash_length )."""
        return cls(kdf(prk_4e3m, KdfLabel.PRK_OUT, th_4, HASH_LENGTH))

    def export(self, label: int, context: bytes, length: int) -> bytes:
        """EDHOC_Exporter (RFC 9528 section 4.2.1)."""
        return kdf(self._prk_exporter, label, context, length)

    def bare(self) -> "EdhocExporter":
        """The same without the cached key for `export`."""
        return EdhocExporter(self.prk_out)

    def update(self, context: bytes) -> "EdhocExporter":
        """EDHOC_KeyUpdate (RFC 9528 section 4.2.2): only forward secrecy."""
        return EdhocExporter(kdf(Secret(self.prk_out), KdfLabel.KEY_UPDATE, context, HASH_LENGTH))

    def __repr__(self) -> str:
        return "Exporter(...)"  # secrets never reach a log

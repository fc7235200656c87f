"""The code of an invitation: one line that lets nodes join, and the key derived from its secret.

It names the root by its hash, so a node knows the authority before it trusts anything. The secret
never leaves the code: both sides derive a P-256 key from it, the authority keeps the public half,
and a node proves the secret by a signature. The text is `ROSSEC-JOIN:` + base32 (RFC 4648): base45
has a space, `$` and `*`, which a shell changes; base64url leaves the alphanumeric mode of QR codes
and is longer there. Its last octets are a checksum, since half of a pasted line looks like a whole.
"""

import base64
import binascii
import re
from dataclasses import dataclass, field
from functools import cached_property
from hashlib import sha256
from hmac import compare_digest
from typing import Final

from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.hashes import SHA256
from cryptography.hazmat.primitives.kdf.hkdf import HKDF
from cryptography.hazmat.primitives.serialization import Encoding, PublicFormat

from ca.encoding import encode
from ca.errors import CodeExpired, CodeRefused
from ca.keys.publickey import require_p256
from ca.keys.signer import KeySigner

PREFIX: Final = "ROSSEC-JOIN:"
MAX_TEXT: Final = 640
SECRET_SIZE: Final = 16
ID_SIZE: Final = 32
_MAX_ADDRESS: Final = 64
_MAX_PATTERN: Final = 255
_ONE_NAME: Final = 0x31  # the low half is the version
_ANONYMOUS: Final = 0x41
_DIGEST_SIZE: Final = 32
_CHECK_SIZE: Final = 4
_FIXED: Final = 1 + _DIGEST_SIZE + SECRET_SIZE + 4 + 1
_KEY: Final = "rossec-join-key-v1"
# FIPS 186-5 A.2.1: 16 octets more than the order has, so that the reduction is not biased.
_KEY_OCTETS: Final = 48
_ORDER: Final = 0xFFFFFFFF00000000FFFFFFFFFFFFFFFFBCE6FAADA7179E84F3B9CAC2FC632551
_ADDRESS: Final = re.compile(r"[!-~]+", re.ASCII)
_PATTERN: Final = re.compile(r"/[A-Za-z0-9_*/]+", re.ASCII)
_HINT: Final = "paste the whole line of `rossec ca invite`, beginning with ROSSEC-JOIN:"


@dataclass(frozen=True)
class InvitationCode:
    """The content of a code.

    Args:
        root: SHA-256 of the authority's root certificate (DER).
        secret: 16 random octets, used for nothing else.
        expires: the last second at which it can be used.
        address: `host:port` of the authority.
        pattern: the names that it allows.
        wildcard: the identities are for anonymous nodes too.
    """

    root: bytes
    secret: bytes = field(repr=False)
    expires: int
    address: str
    pattern: str
    wildcard: bool = False

    def __post_init__(self) -> None:
        sizes = len(self.root) == _DIGEST_SIZE and len(self.secret) == SECRET_SIZE
        if not sizes or not 0 <= self.expires < 1 << 32:
            raise CodeRefused("the sizes of an invitation's parts are wrong")
        if not _ADDRESS.fullmatch(self.address) or len(self.address) > _MAX_ADDRESS:
            raise CodeRefused(
                f"the address of an invitation has 1 to {_MAX_ADDRESS} characters of ASCII",
                "give a shorter one: --address 192.168.1.7",
            )
        if not _PATTERN.fullmatch(self.pattern) or len(self.pattern) > _MAX_PATTERN:
            raise CodeRefused("the invitation has no pattern of names", _HINT)

    @cached_property
    def signer(self) -> KeySigner:
        """The key derived from the secret and the root's hash."""
        info = encode([_KEY, self.root])
        octets = HKDF(SHA256(), _KEY_OCTETS, salt=None, info=info).derive(self.secret)
        scalar = int.from_bytes(octets) % (_ORDER - 1) + 1
        return KeySigner(ec.derive_private_key(scalar, ec.SECP256R1()))

    @property
    def key(self) -> bytes:
        """Its public half, which the authority keeps: an uncompressed point, 65 octets."""
        return self.signer.public_key.public_bytes(Encoding.X962, PublicFormat.UncompressedPoint)

    @property
    def id(self) -> bytes:
        """The SHA-256 of `key`: the name of the invitation, not secret."""
        return sha256(self.key).digest()

    def check_time(self, now: int) -> None:
        """Return if the code has not expired; the authority decides that by its own clock.

        Raises:
            CodeExpired: it has.
        """
        if now > self.expires:
            raise CodeExpired(
                f"the invitation expired {now - self.expires} s ago",
                "check this computer's clock; for another: rossec ca invite PATTERN",
            )

    def body(self) -> bytes:
        """The content as octets, with the checksum: what a tag for NFC holds."""
        address = self.address.encode()
        body = b"".join((
            bytes([_ANONYMOUS if self.wildcard else _ONE_NAME]),
            self.root, self.secret, self.expires.to_bytes(4), bytes([len(address)]), address,
            self.pattern.encode(),
        ))  # fmt: skip
        return body + _checksum(body)

    def text(self) -> str:
        """The code as one line, to be pasted or drawn."""
        return PREFIX + base64.b32encode(self.body()).decode().rstrip("=")


def parse(text: str) -> InvitationCode:
    """Parse a code as pasted: a mail or a chat may have broken its line, so white space is ignored.

    Raises:
        CodeRefused: not a code of an invitation, incomplete, or of an unknown version.
    """
    stripped = "".join(text.split())
    if len(stripped) > MAX_TEXT or not stripped.startswith(PREFIX):
        raise CodeRefused("this is not the code of an invitation", _HINT)
    digits = stripped.removeprefix(PREFIX)
    try:
        body = base64.b32decode(digits + "=" * (-len(digits) % 8))
    except (binascii.Error, ValueError) as error:
        raise _damaged() from error
    found = parse_body(body)
    if found.text() != stripped:  # the last digit has bits that mean nothing
        raise _damaged()
    return found


def parse_body(body: bytes) -> InvitationCode:
    """Parse the octets of a code (`InvitationCode.body`).

    Raises:
        CodeRefused: as `parse`.
    """
    content, check = body[:-_CHECK_SIZE], body[-_CHECK_SIZE:]
    if len(content) <= _FIXED or not compare_digest(_checksum(content), check):
        raise _damaged()
    kind, root, rest = content[0], content[1 : 1 + _DIGEST_SIZE], content[1 + _DIGEST_SIZE :]
    if kind not in {_ONE_NAME, _ANONYMOUS}:
        raise CodeRefused(
            "an invitation of another version of rossec", "update the older of the two sides"
        )
    secret, expires, size = rest[:SECRET_SIZE], rest[SECRET_SIZE:][:4], rest[SECRET_SIZE + 4]
    texts = rest[SECRET_SIZE + 5 :]
    if not texts.isascii() or size >= len(texts):
        raise _damaged()
    return InvitationCode(
        root, secret, int.from_bytes(expires), texts[:size].decode(), texts[size:].decode(),
        wildcard=kind == _ANONYMOUS,
    )  # fmt: skip


def public_key(point: bytes) -> ec.EllipticCurvePublicKey:
    """The key that `InvitationCode.key` wrote.

    Raises:
        CodeRefused: not a point of the curve.
    """
    try:
        return require_p256(ec.EllipticCurvePublicKey.from_encoded_point(ec.SECP256R1(), point))
    except ValueError as error:
        raise CodeRefused("the key of the invitation is not a point of P-256") from error


def _checksum(body: bytes) -> bytes:
    return sha256(body).digest()[:_CHECK_SIZE]


def _damaged() -> CodeRefused:
    return CodeRefused("the code of the invitation is incomplete or damaged", _HINT)

"""What lets nodes join: the code of an invitation, the tag that holds it, and the proofs of its secret.

The code names the root by its hash, so a node knows the authority before it trusts anything. `/ca`
signs the transcript, the node signs it with its request. Requests and claims come from strangers:
nothing in them is looked at before the proof over their hashes is verified.
"""

import base64
import binascii
import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from hashlib import sha256
from hmac import compare_digest
from typing import Final, Self

from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.hashes import SHA256
from cryptography.hazmat.primitives.kdf.hkdf import HKDF
from cryptography.hazmat.primitives.serialization import Encoding, PublicFormat

from ca import names, svid
from ca.encoding import Value, encode
from ca.errors import CodeRefused, EnrollmentMessageRefused, EnrollmentRefused, JoinRefused, SignatureError
from ca.keys.signing import KeySigner, Profile, PublicKey, Signer, require_p256

# The text is base32 (RFC 4648): base45 has a space, `$` and `*`, which a shell changes; base64url
# leaves the alphanumeric mode of QR codes and is longer there. Its last octets are a checksum, since
# half of a pasted line looks like a whole.
PREFIX: Final = "ROSSEC-JOIN:"
MAX_TEXT: Final = 640
SECRET_SIZE: Final = 16
ID_SIZE: Final = 32
_MAX_ADDRESS: Final = 64
_MAX_PATTERN: Final = 255
_ONE_NAME: Final = 0x31  # the low half is the version
_ANONYMOUS: Final = 0x41
_CHECK_SIZE: Final = 4
_DIGEST_SIZE: Final = 32
_FIXED: Final = 1 + _DIGEST_SIZE + SECRET_SIZE + 4 + 1
_KEY: Final = "rossec-join-key-v1"
# FIPS 186-5 A.2.1: 16 octets more than the order has, so that the reduction is not biased.
_KEY_OCTETS: Final = 48
_ORDER: Final = 0xFFFFFFFF00000000FFFFFFFFFFFFFFFFBCE6FAADA7179E84F3B9CAC2FC632551
_ADDRESS: Final = re.compile(r"[!-~]+", re.ASCII)
_PATTERN: Final = re.compile(r"/[A-Za-z0-9_*/]+", re.ASCII)
_HINT: Final = "paste the whole line of `rossec ca invite`, beginning with ROSSEC-JOIN:"

# On an NFC tag: an NDEF message of one record of MIME media (NFC Forum, NDEF 1.0), whose payload is
# the octets of the code, not its text: so it fits on the smallest common tag (NTAG213, 144 octets).
# A phone that reads it opens nothing: only a URI or a well-known type would be acted on.
MEDIA_TYPE: Final = b"application/vnd.rossec.join"
MAX_MESSAGE: Final = 512
# Message begin and end, TNF 2 (NDEF 3.2): with a payload length of one octet, or of four.
_SHORT: Final = 0xD2
_LONG: Final = 0xC2

MAX_STATEMENT: Final = 512
MAX_METADATA: Final = 4096  # what a node says of itself, where rules give names
_CONTEXT: Final = "rossec-join-v1"
_LIVE: Final = Profile("rossec-join-live+cbor")
_PROOF: Final = Profile("rossec-join-proof+cbor")
_CLAIM: Final = Profile("rossec-join-claim+cbor")

_SIZES: Final = ID_SIZE + _DIGEST_SIZE  # where those of proof, name and metadata are
_HEAD: Final = _SIZES + 5
MAX_REQUEST_SIZE: Final = _HEAD + MAX_STATEMENT + names.MAX_NAME + MAX_METADATA + svid.MAX_REQUEST

_CLAIM_HEAD: Final = ID_SIZE + _DIGEST_SIZE + 2  # and the size of the proof
MAX_CLAIM_SIZE: Final = _CLAIM_HEAD + MAX_STATEMENT + MAX_METADATA


@dataclass(frozen=True)
class InvitationCode:
    root: bytes  # SHA-256 of the authority's root certificate (DER)
    secret: bytes = field(repr=False)  # 16 random octets, used for nothing else
    expires: int  # the last second at which it can be used
    address: str  # `host:port` of the authority
    pattern: str  # the names that it allows
    wildcard: bool = False  # the identities are for anonymous nodes too

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
        # The secret never leaves the code: the authority keeps the public half, so a copy of its record lets
        # nobody join. The root is in it: one secret at two authorities is two keys.
        info = encode([_KEY, self.root])
        octets = HKDF(SHA256(), _KEY_OCTETS, salt=None, info=info).derive(self.secret)
        scalar = int.from_bytes(octets) % (_ORDER - 1) + 1
        return KeySigner(ec.derive_private_key(scalar, ec.SECP256R1()))

    @property
    def key(self) -> bytes:
        return self.signer.public_key.public_bytes(Encoding.X962, PublicFormat.UncompressedPoint)

    @property
    def id(self) -> bytes:
        return sha256(self.key).digest()

    def check_time(self, now: int) -> None:
        """Return if the code has not expired; the authority decides that by its own clock."""
        if now > self.expires:
            raise CodeRefused(
                f"the invitation expired {now - self.expires} s ago",
                "check this computer's clock; for another: rossec ca invite PATTERN",
            )

    def body(self) -> bytes:
        """The content as octets, with the checksum: what a tag for NFC holds."""
        kind, address = bytes([_ANONYMOUS if self.wildcard else _ONE_NAME]), self.address.encode()
        fixed = kind + self.root + self.secret + self.expires.to_bytes(4) + bytes([len(address)])
        body = fixed + address + self.pattern.encode()
        return body + _checksum(body)

    def text(self) -> str:
        return PREFIX + base64.b32encode(self.body()).decode().rstrip("=")


def parse(text: str) -> InvitationCode:
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
    content, check = body[:-_CHECK_SIZE], body[-_CHECK_SIZE:]
    if len(content) <= _FIXED or not compare_digest(_checksum(content), check):
        raise _damaged()
    kind, root, rest = content[0], content[1 : 1 + _DIGEST_SIZE], content[1 + _DIGEST_SIZE :]
    if kind not in {_ONE_NAME, _ANONYMOUS}:
        raise CodeRefused("an invitation of another version of rossec", "update the older of the two sides")
    secret, expires, size = rest[:SECRET_SIZE], rest[SECRET_SIZE:][:4], rest[SECRET_SIZE + 4]
    texts = rest[SECRET_SIZE + 5 :]
    if not texts.isascii() or size >= len(texts):
        raise _damaged()
    address, pattern = texts[:size].decode(), texts[size:].decode()
    return InvitationCode(
        root, secret, int.from_bytes(expires), address, pattern, wildcard=kind == _ANONYMOUS
    )


def public_key(point: bytes) -> PublicKey:
    try:
        return require_p256(PublicKey.from_encoded_point(ec.SECP256R1(), point))
    except ValueError as error:
        raise CodeRefused("the key of the invitation is not a point of P-256") from error


def _checksum(body: bytes) -> bytes:
    return sha256(body).digest()[:_CHECK_SIZE]


def _damaged() -> CodeRefused:
    return CodeRefused("the code of the invitation is incomplete or damaged", _HINT)


def write(code: InvitationCode) -> bytes:
    payload = code.body()
    if len(payload) < 256:
        head = bytes([_SHORT, len(MEDIA_TYPE), len(payload)])
    else:
        head = bytes([_LONG, len(MEDIA_TYPE)]) + len(payload).to_bytes(4)
    return head + MEDIA_TYPE + payload


def is_message(data: bytes) -> bool:
    """Whether `data` begins as an NDEF message: the text of a code never does."""
    return data[:1] in {bytes([_SHORT]), bytes([_LONG])}


def read(data: bytes) -> InvitationCode:
    if len(data) <= MAX_MESSAGE and is_message(data):
        start = (3 if data[0] == _SHORT else 6) + len(MEDIA_TYPE)
        code = parse_body(data[start:])
        if write(code) == data:
            return code
    raise CodeRefused(
        "the tag does not hold an invitation of rossec", "write it with: rossec ca invite PATTERN --ndef FILE"
    )


def transcript(
    invitation: bytes, node_nonce: bytes, own_nonce: bytes, chain: Sequence[bytes], root: bytes
) -> bytes:
    # The invitation, a fresh nonce of each side, the certificates: neither signs what the other chooses.
    certificates: list[Value] = [_digest(certificate) for certificate in chain]
    return _digest(encode([_CONTEXT, invitation, node_nonce, own_nonce, certificates, _digest(root)]))


def sign_live(signer: Signer, transcript_hash: bytes) -> bytes:
    return _LIVE.sign(signer, [transcript_hash])


def check_live(data: bytes, key: PublicKey, transcript_hash: bytes) -> None:
    try:
        _LIVE.check(data, key, [transcript_hash])
    except SignatureError as error:
        raise EnrollmentRefused(
            f"the peer does not have the key of the authority's node: {error}",
            "possible attacker in between: find out who answers at that address",
        ) from error


def sign_proof(signer: Signer, transcript_hash: bytes, csr: bytes, name: str, metadata: bytes = b"") -> bytes:
    return _PROOF.sign(signer, _asked(transcript_hash, csr, name, metadata))


def check_proof(
    data: bytes, key: PublicKey, transcript_hash: bytes, csr: bytes, name: str, metadata: bytes = b""
) -> None:
    """Return if the holder of the secret asks for `csr` in this join. It is only hashed."""
    _check(_PROOF, data, key, _asked(transcript_hash, csr, name, metadata))


def sign_claim(signer: Signer, transcript_hash: bytes, metadata: bytes) -> bytes:
    return _CLAIM.sign(signer, [transcript_hash, _digest(metadata)])


def check_claim(data: bytes, key: PublicKey, transcript_hash: bytes, metadata: bytes) -> None:
    """Return if the holder of the secret sends `metadata`, which are only hashed."""
    _check(_CLAIM, data, key, [transcript_hash, _digest(metadata)])


def _asked(transcript_hash: bytes, csr: bytes, name: str, metadata: bytes) -> list[Value]:
    # What a proof is about; metadata only if there are some, as in version 1 without them.
    asked: list[Value] = [transcript_hash, _digest(csr), name]
    return [*asked, _digest(metadata)] if metadata else asked


def _check(profile: Profile, data: bytes, key: PublicKey, content: list[Value]) -> None:
    try:
        profile.check(data, key, content)
    except SignatureError as error:
        raise JoinRefused(f"the node does not prove the invitation's secret: {error}") from error


def _digest(data: bytes) -> bytes:
    return sha256(data).digest()


@dataclass(frozen=True)
class JoinRequest:
    """A node's request to join; everything is untrusted until `verify`."""

    invitation: bytes  # its id
    transcript: bytes
    name: str  # ASCII
    csr: bytes  # DER
    proof: bytes
    metadata: bytes = b""  # empty: the node chose its name itself

    def __post_init__(self) -> None:
        exact = len(self.invitation) == ID_SIZE and len(self.transcript) == _DIGEST_SIZE
        fits = (
            self.name.isascii()
            and len(self.name) <= names.MAX_NAME
            and len(self.csr) <= svid.MAX_REQUEST
            and len(self.proof) <= MAX_STATEMENT
            and len(self.metadata) <= MAX_METADATA
        )
        if not exact or not fits:
            raise EnrollmentMessageRefused("the parts of a request to join have wrong sizes")

    @property
    def digest(self) -> bytes:
        return sha256(self.csr).digest()

    def to_bytes(self) -> bytes:
        name, parts = self.name.encode(), (self.invitation, self.transcript)
        sizes = len(self.proof).to_bytes(2) + len(name).to_bytes(1) + len(self.metadata).to_bytes(2)
        return b"".join((*parts, sizes, self.proof, name, self.metadata, self.csr))

    @classmethod
    def from_bytes(cls, data: bytes) -> Self:
        # The octets are cut, not parsed: this is what the process with the key gets from the one without.
        name = _HEAD + int.from_bytes(data[_SIZES : _SIZES + 2])
        metadata = name + int.from_bytes(data[_SIZES + 2 : _SIZES + 3])
        csr = metadata + int.from_bytes(data[_SIZES + 3 : _HEAD])
        if not csr <= len(data) <= MAX_REQUEST_SIZE or not data[name:metadata].isascii():
            raise EnrollmentMessageRefused("a request to join of a wrong size")
        asked, proof = data[name:metadata].decode(), data[_HEAD:name]
        return cls(data[:ID_SIZE], data[ID_SIZE:_SIZES], asked, data[csr:], proof, data[metadata:csr])

    def verify(self, point: bytes) -> None:
        key = public_key(point)
        check_proof(self.proof, key, self.transcript, self.csr, self.name, self.metadata)


@dataclass(frozen=True)
class JoinClaim:
    """The invitation's id, the transcript, metadata, and the proof; untrusted until `verify`."""

    invitation: bytes
    transcript: bytes
    metadata: bytes
    proof: bytes

    def __post_init__(self) -> None:
        exact = len(self.invitation) == ID_SIZE and len(self.transcript) == _DIGEST_SIZE
        fits = 0 < len(self.metadata) <= MAX_METADATA and len(self.proof) <= MAX_STATEMENT
        if not exact or not fits:
            raise EnrollmentMessageRefused("the parts of a claim have wrong sizes")

    def to_bytes(self) -> bytes:
        size = len(self.proof).to_bytes(2)
        return b"".join((self.invitation, self.transcript, size, self.proof, self.metadata))

    @classmethod
    def from_bytes(cls, data: bytes) -> Self:
        metadata = _CLAIM_HEAD + int.from_bytes(data[_CLAIM_HEAD - 2 : _CLAIM_HEAD])
        if not metadata < len(data) <= MAX_CLAIM_SIZE:
            raise EnrollmentMessageRefused("a claim of a wrong size")
        transcript = data[ID_SIZE : ID_SIZE + _DIGEST_SIZE]
        return cls(data[:ID_SIZE], transcript, data[metadata:], data[_CLAIM_HEAD:metadata])

    def verify(self, point: bytes) -> None:
        check_claim(self.proof, public_key(point), self.transcript, self.metadata)

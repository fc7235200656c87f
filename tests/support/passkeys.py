"""A software authenticator: a passkey that makes registrations and assertions, as bytes.

Written from WebAuthn level 2 (sections 5.8.1, 6.1, 6.5, 7.2) without the library that verifies
them. Every field can be given another value, to be refused.
"""

import copy
import json
import secrets
from base64 import urlsafe_b64encode
from hashlib import sha256
from typing import Final, NamedTuple, Self

from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric import ec

from ca.encoding import encode

RP_ID: Final = "localhost"
ORIGIN: Final = "http://localhost:7411"
UP, UV, BE, BS, AT, ED = 0x01, 0x04, 0x08, 0x10, 0x40, 0x80
CREATE, GET = "webauthn.create", "webauthn.get"
_EC2, _ES256, _P256 = 2, -7, 1


class Registration(NamedTuple):
    """What `navigator.credentials.create` returns, in the order of "add-passkey"."""

    client_data: bytes
    attestation: bytes


class Assertion(NamedTuple):
    """What `navigator.credentials.get` returns, in the order of "approve" and "login"."""

    credential: bytes
    client_data: bytes
    authenticator_data: bytes
    signature: bytes


class Passkey:
    """One credential, for one relying party.

    Args:
        rp_id: of the relying party.
        origin: of the page that asks.
        counts: whether it counts its signatures; a synced one does not.
    """

    def __init__(self, rp_id: str = RP_ID, origin: str = ORIGIN, *, counts: bool = True) -> None:
        self.key = ec.generate_private_key(ec.SECP256R1())
        self.id = secrets.token_bytes(32)
        self.rp_id, self.origin, self.counts = rp_id, origin, counts
        self.count = 0

    def clone(self) -> Self:
        """A copy that counts by itself from now on."""
        return copy.copy(self)

    @property
    def cose_key(self) -> bytes:
        """The public key as COSE_Key (RFC 9053)."""
        numbers = self.key.public_key().public_numbers()
        x, y = numbers.x.to_bytes(32), numbers.y.to_bytes(32)
        return encode({1: _EC2, 3: _ES256, -1: _P256, -2: x, -3: y})

    def register(
        self,
        challenge: bytes,
        *,
        flags: int = UP | UV | AT,
        kind: str = CREATE,
        rp_id: str | None = None,
        origin: str | None = None,
        cross_origin: bool | None = False,
        aaguid: bytes = bytes(16),
        form: str = "none",
    ) -> Registration:
        """Register at a relying party that sent `challenge`."""
        attested = aaguid + len(self.id).to_bytes(2) + self.id + self.cose_key
        data = self.authenticator_data(flags, rp_id) + attested
        attestation = encode({"fmt": form, "attStmt": {}, "authData": data})
        return Registration(self.client_data(kind, challenge, origin, cross_origin), attestation)

    def sign(
        self,
        challenge: bytes,
        *,
        flags: int = UP | UV,
        kind: str = GET,
        rp_id: str | None = None,
        origin: str | None = None,
        cross_origin: bool | None = False,
    ) -> Assertion:
        """Sign `challenge`: a person touched it and proved who they are, unless `flags` differ."""
        self.count += self.counts
        client_data = self.client_data(kind, challenge, origin, cross_origin)
        data = self.authenticator_data(flags, rp_id)
        signed = data + sha256(client_data).digest()
        signature = self.key.sign(signed, ec.ECDSA(hashes.SHA256()))
        return Assertion(self.id, client_data, data, signature)

    def authenticator_data(self, flags: int, rp_id: str | None = None) -> bytes:
        """Its beginning, which every answer has (section 6.1)."""
        party = self.rp_id if rp_id is None else rp_id
        return sha256(party.encode()).digest() + bytes([flags]) + self.count.to_bytes(4)

    def client_data(
        self, kind: str, challenge: bytes, origin: str | None, cross_origin: bool | None
    ) -> bytes:
        """What the browser adds (section 5.8.1); without `crossOrigin` if that is None."""
        fields: dict[str, object] = {
            "type": kind,
            "challenge": urlsafe_b64encode(challenge).rstrip(b"=").decode(),
            "origin": self.origin if origin is None else origin,
        }
        if cross_origin is not None:
            fields["crossOrigin"] = cross_origin
        return json.dumps(fields, separators=(",", ":")).encode()

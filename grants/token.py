"""What a node presents: a grant as signed by the authority, alone or with a ticket that renews it.

A renewed grant is sent as the deterministic CBOR array [grant, ticket, delegation], each as signed.
The verifier also needs the key of the delegate, its master. That key is not in the token, so a peer
cannot choose who renewed its grant.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, NamedTuple

from cryptography.hazmat.primitives.asymmetric import ec

from ca.encoding import MAX_SIZE as MAX_GRANT
from ca.encoding import decode, encode
from ca.errors import EncodingError
from ca.keys.publickey import thumbprint
from grants.document import open_grant, verify
from grants.errors import GrantMalformed, RenewalForOther
from grants.model import Grant
from grants.renewal import MAX_STATEMENT, open_delegation, renew

MAX_TOKEN: Final = MAX_GRANT + 2 * MAX_STATEMENT + 16
_ARRAY_OF_3: Final = b"\x83"  # a grant begins with its tag, 0xd2


class TokenParts(NamedTuple):
    """The parts of a token; `ticket` and `delegation` are empty for a grant without renewal."""

    grant: bytes
    ticket: bytes = b""
    delegation: bytes = b""


@dataclass(frozen=True)
class Verifier:
    """Verifies tokens.

    Args:
        ca_key, domain: the authority, and the trust domain the grant must be for.
        delegates: the keys of the masters whose tickets count; none: renewed grants are refused.
        seq: number of the newest revocation list of this node.
        check: called as `check(id, now)`; raises when a grant or delegation is revoked.
    """

    ca_key: ec.EllipticCurvePublicKey
    domain: str
    delegates: tuple[ec.EllipticCurvePublicKey, ...]
    seq: int
    check: Callable[[bytes, int], None]

    def open(self, token: bytes, now: int) -> Grant:
        """Verify a token and return the grant, with the expiry of its ticket if renewed.

        Raises:
            GrantError: as `document.open_grant`, and for a renewed one as `renewal.renew`.
        """
        parts = unpack(token)
        if not parts.ticket:
            return open_grant(parts.grant, self.ca_key, now, domain=self.domain)
        if not self.delegates:
            raise RenewalForOther(
                "a renewed grant, but the master's key is not known", "connect to the master first"
            )
        grant = verify(parts.grant, self.ca_key, domain=self.domain)
        delegation = open_delegation(parts.delegation, self.ca_key)
        of_holder = (key for key in self.delegates if thumbprint(key) == delegation.holder)
        key = next(of_holder, self.delegates[0])  # another one's: refused as such
        return renew(grant, parts.ticket, delegation, key, now=now, seq=self.seq, check=self.check)


def pack(grant: bytes, ticket: bytes, delegation: bytes) -> bytes:
    """The token of a renewed grant."""
    return encode([grant, ticket, delegation])


def unpack(token: bytes) -> TokenParts:
    """Split a token; nothing is verified.

    Raises:
        GrantMalformed: an array other than [grant, ticket, delegation].
    """
    if not token.startswith(_ARRAY_OF_3):
        return TokenParts(token)
    try:
        value = decode(token, limit=MAX_TOKEN)
    except EncodingError as error:
        raise GrantMalformed(f"not a renewed grant: {error}") from None
    match value:
        case [bytes() as grant, bytes() as ticket, bytes() as delegation] if all(value):
            return TokenParts(grant, ticket, delegation)
        case _:
            raise GrantMalformed("a renewed grant is [grant, ticket, delegation]")

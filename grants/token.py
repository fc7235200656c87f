"""What a node presents: a grant as signed, one with a ticket that renews it, or a chain.

A renewed grant is sent as the deterministic CBOR array [grant, ticket, delegation], each as signed;
a chain as [one of these, [narrowing, ...]]. The verifier also needs the key of the delegate, its
master. That key is not in the token, so a peer cannot choose who renewed its grant.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

from cryptography.hazmat.primitives.asymmetric import ec

from ca.encoding import MAX_SIZE as MAX_GRANT
from ca.encoding import decode, encode
from ca.errors import EncodingError
from ca.keys.publickey import thumbprint
from grants import document
from grants.document import open_grant, verify
from grants.errors import GrantMalformed, RenewalForOther
from grants.model import MAX_NARROWINGS, Grant
from grants.narrowing import MAX_NARROWING, follow, peek_chain
from grants.renewal import MAX_STATEMENT, open_delegation, renew

MAX_SINGLE: Final = MAX_GRANT + 2 * MAX_STATEMENT + 16
MAX_TOKEN: Final = 64 * 1024
_ARRAY_OF_2: Final = b"\x82"
_ARRAY_OF_3: Final = b"\x83"  # a grant begins with its tag, 0xd2


class TokenParts(NamedTuple):
    """The parts of a token; `ticket` and `delegation` are empty for a grant without renewal.

    `narrowings` are those of a chain, in order.
    """

    grant: bytes
    ticket: bytes = b""
    delegation: bytes = b""
    narrowings: tuple[bytes, ...] = ()


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

        That a chain stays in one domain is checked by who knows the peer
        (`narrowing.check_one_domain`).

        Raises:
            GrantError: as `document.open_grant`, for a renewed one as `renewal.renew`, for a chain
                as `narrowing.follow`.
        """
        parts = unpack(token)
        grant = self._open_single(parts, now)
        return follow(grant, parts.narrowings, now) if parts.narrowings else grant

    def _open_single(self, parts: TokenParts, now: int) -> Grant:
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


def pack_chain(token: bytes, narrowings: Sequence[bytes]) -> bytes:
    """The token of a chain: `token` is that of its grant, or of a shorter chain.

    Raises:
        GrantMalformed: larger than a token may be, or too many narrowings.
    """
    parts = unpack(token)
    if parts.narrowings:
        token, narrowings = _split_chain(token)[0], (*parts.narrowings, *narrowings)
    packed = encode([token, [*narrowings]])
    unpack(packed)
    return packed


def unpack(token: bytes) -> TokenParts:
    """Split a token; nothing is verified. Sizes are checked before anything is parsed.

    Raises:
        GrantMalformed: too large, or an array other than [grant, ticket, delegation] or
            [token, [narrowing, ...]].
    """
    if token.startswith(_ARRAY_OF_2):
        single, narrowings = _split_chain(token)
        return _unpack_single(single)._replace(narrowings=narrowings)
    return _unpack_single(token)


def peek(token: bytes) -> Grant:
    """The content of a token *without* verifying it: to show or to hold it, or to find its key.

    Raises:
        GrantMalformed: not a token, or outside the closed schemas.
    """
    parts = unpack(token)
    grant = document.peek(parts.grant)
    return peek_chain(grant, parts.narrowings) if parts.narrowings else grant


def _split_chain(token: bytes) -> tuple[bytes, tuple[bytes, ...]]:
    try:
        value = decode(token, limit=MAX_TOKEN)
    except EncodingError as error:
        raise GrantMalformed(f"not a chain of narrowings: {error}") from None
    match value:
        case [bytes() as single, [*items]] if single[:1] != _ARRAY_OF_2 and items:
            narrowings = tuple(item for item in items if isinstance(item, bytes))
        case _:
            raise GrantMalformed(f"a chain is [token, [1 to {MAX_NARROWINGS} narrowings]]")
    if len(items) > MAX_NARROWINGS:
        raise GrantMalformed(f"more than {MAX_NARROWINGS} narrowings")
    if len(narrowings) != len(items) or not all(0 < len(n) <= MAX_NARROWING for n in narrowings):
        raise GrantMalformed("a narrowing is empty, too large, or not bytes")
    return single, narrowings


def _unpack_single(token: bytes) -> TokenParts:
    if not token.startswith(_ARRAY_OF_3):
        return TokenParts(token)
    try:
        value = decode(token, limit=MAX_SINGLE)
    except EncodingError as error:
        raise GrantMalformed(f"not a renewed grant: {error}") from None
    match value:
        case [bytes() as grant, bytes() as ticket, bytes() as delegation] if all(value):
            return TokenParts(grant, ticket, delegation)
        case _:
            raise GrantMalformed("a renewed grant is [grant, ticket, delegation]")

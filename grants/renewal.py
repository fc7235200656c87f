"""Renewal: a grant stays valid, unchanged, as long as the master confirms it within bounds.

The authority signs a *delegation* to the master's key; the master signs short *tickets* for grants. What a
stolen master key allows: tickets for existing grants, up to their caps, until the delegation ends or is
revoked.
"""

import hashlib
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Final

from cryptography.hazmat.primitives.asymmetric import ec

from ca.encoding import Value, decode
from ca.errors import EncodingError, HintedError, SignatureError
from ca.keys.signing import Profile, Signer, thumbprint
from grants.document import issuer_uri, read_issuer
from grants.errors import (
    GrantForged,
    GrantForOther,
    GrantMalformed,
    GrantRevoked,
    GrantTooWide,
    RenewalNotInTime,
)
from grants.model import ID_SIZE, KEY_SIZE, Grant, format_time

DELEGATION: Final = Profile("rossec-delegation+cwt")
TICKET: Final = Profile("rossec-ticket+cwt")

MAX_STATEMENT: Final = 1024  # bytes
MAX_DELEGATION: Final = 90 * 86400  # maximum lifetime of a delegation, seconds
MAX_TICKET: Final = 7 * 86400  # maximum lifetime of a ticket, seconds
# Minimum `max_ttl` in the tools: a node renews after two thirds, and may have to retry.
MIN_TICKET: Final = 60

_MAX_TIME: Final = 1 << 53
_ID_PREFIX: Final = b"rossec-delegation-id\0" + len(DELEGATION.protected).to_bytes(4) + DELEGATION.protected

# RFC 8392 section 3.1, RFC 8747; below -65536 for private use.
_ISS, _AUD, _EXP, _NBF, _CTI, _CNF, _CKT = 1, 3, 4, 5, 7, 8, 5
_SEQ, _MAX_TTL, _GRANT = -70002, -70010, -70011

RevocationCheck = Callable[[bytes, int], None]


@dataclass(frozen=True)
class Delegation:
    """Authorizes one key to renew grants of one authority in one domain."""

    domain: str
    holder: bytes  # thumbprint of the key that may sign tickets
    not_before: int  # seconds since the epoch, as `expires`; at most 90 days apart
    expires: int
    max_ttl: int  # maximum lifetime of a ticket in seconds, at most 7 days
    serial: bytes  # random

    def __post_init__(self) -> None:
        if not 0 < len(self.domain.encode()) <= 255:
            raise GrantMalformed("a delegation needs a trust domain of 1 to 255 bytes")
        if len(self.holder) != KEY_SIZE or len(self.serial) != ID_SIZE:
            raise GrantMalformed("holder must be 32 bytes, serial 16")
        if not 0 <= self.not_before < self.expires < _MAX_TIME:
            raise GrantMalformed("a delegation needs not_before < expires")
        if self.expires - self.not_before > MAX_DELEGATION or not 0 < self.max_ttl <= MAX_TICKET:
            raise GrantMalformed("a delegation is valid for at most 90 days, its tickets 7")


@dataclass(frozen=True)
class OpenDelegation(Delegation):
    """A delegation as signed: `id` identifies it for revocation."""

    id: bytes
    issuer: bytes


@dataclass(frozen=True)
class Ticket:
    """Confirms a grant from `not_before` until `expires`, as of revocation list `seq`."""

    # No field for rights, so a renewal can widen none; the grant keeps its bytes, its id and its place in the
    # revocation list.
    grant: bytes
    not_before: int
    expires: int
    seq: int

    def __post_init__(self) -> None:
        if len(self.grant) != ID_SIZE or not 0 <= self.seq < _MAX_TIME:
            raise GrantMalformed("a ticket has a grant id of 16 bytes and the number of a list")
        if not 0 <= self.not_before < self.expires < _MAX_TIME:
            raise GrantMalformed("a ticket needs not_before < expires")


def sign_delegation(signer: Signer, delegation: Delegation) -> bytes:
    """Sign as the authority."""
    return DELEGATION.sign(
        signer,
        {
            _ISS: issuer_uri(thumbprint(signer.public_key)),
            _AUD: delegation.domain,
            _EXP: delegation.expires,
            _NBF: delegation.not_before,
            _CTI: delegation.serial,
            _CNF: {_CKT: delegation.holder},
            _MAX_TTL: delegation.max_ttl,
        },
    )


def sign_ticket(signer: Signer, ticket: Ticket) -> bytes:
    """Sign as the holder of a delegation."""
    return TICKET.sign(
        signer, {_EXP: ticket.expires, _NBF: ticket.not_before, _SEQ: ticket.seq, _GRANT: ticket.grant}
    )


def open_delegation(data: bytes, ca_key: ec.EllipticCurvePublicKey) -> OpenDelegation:
    """Verify and read a delegation; its validity is checked when it is used."""
    body = _open(DELEGATION, data, ca_key)
    match _decode(body):
        case {
            1: str() as iss,
            3: str() as aud,
            4: exp,
            5: nbf,
            7: bytes() as cti,
            8: {5: bytes() as ckt, **more},
            -70010: ttl,
            **rest,
        } if not rest and not more:
            delegation_id = hashlib.sha256(_ID_PREFIX + body).digest()[:ID_SIZE]
            times = (_number(nbf), _number(exp), _number(ttl))
            try:
                issuer = read_issuer(iss)
            except GrantMalformed as error:
                raise GrantMalformed(f"in a delegation: {error}") from None
            opened = OpenDelegation(aud, ckt, *times, cti, delegation_id, issuer)
        case _:
            raise GrantMalformed("the delegation has missing or unknown claims")
    if opened.issuer != thumbprint(ca_key):
        raise GrantForOther("signed by this authority, but iss is another one")
    return opened


def open_ticket(data: bytes, key: ec.EllipticCurvePublicKey) -> Ticket:
    match _decode(_open(TICKET, data, key)):
        case {4: exp, 5: nbf, -70002: seq, -70011: bytes() as grant, **rest} if not rest:
            return Ticket(grant, _number(nbf), _number(exp), _number(seq))
        case _:
            raise GrantMalformed("the ticket has missing or unknown claims")


def renew(  # noqa: C901, PLR0912 - the conditions of the spec in their order
    grant: Grant,
    ticket: bytes,
    delegation: OpenDelegation,
    key: ec.EllipticCurvePublicKey,
    *,
    now: int,
    seq: int,
    check: RevocationCheck,
) -> Grant:
    # The numbered conditions of docs/spec/grant.md, section 7. 1: signed by the delegation's key.
    if delegation.holder != thumbprint(key):
        raise GrantForOther("the delegation is for another key than this one")
    if (grant.issuer, grant.domain) != (delegation.issuer, delegation.domain):
        raise GrantForOther("the delegation is of another authority or domain than the grant")
    opened = open_ticket(ticket, key)
    # 2. Of the same authority and domain, and for this grant.
    if opened.grant != grant.id:
        raise GrantForOther(f"the ticket is not for grant {grant.short_id}")
    # 3. A grant that may be renewed, no further than its cap and what was delegated.
    if grant.cap <= grant.expires:
        raise GrantTooWide(f"grant {grant.short_id} is not renewable", "ask for a new grant")
    for end, whose in ((grant.cap, "grant's cap"), (delegation.expires, "delegation's end")):
        if opened.expires > end:
            raise GrantTooWide(f"the ticket extends beyond {format_time(end)}, the {whose}")
    if opened.expires - opened.not_before > delegation.max_ttl:
        raise GrantTooWide(f"a ticket for more than {delegation.max_ttl} s")
    # 4. Valid now, all three; the grant's own end is what the ticket replaces.
    statements: tuple[tuple[str, Delegation | Ticket | Grant], ...]
    statements = ("delegation", delegation), ("ticket", opened), ("grant", grant)
    for what, each in statements:
        if now < each.not_before:
            begin = f"the {what} is not valid before {format_time(each.not_before)}"
            raise RenewalNotInTime(begin, "check this host's clock")
        if each is not grant and now >= each.expires:
            end_text = f"the {what} expired at {format_time(each.expires)}"
            raise RenewalNotInTime(end_text, "ask the master for a new ticket")
    # 5. Made with no newer list than the verifier's: that list may revoke the grant.
    if opened.seq > seq:
        raise RenewalNotInTime(
            f"the ticket requires revocation list {opened.seq}, this host has {seq}", "fetch the list first"
        )
    # 6. Nothing it rests on is revoked; `via` has it checked again at every decision.
    via = (delegation.id, delegation.holder)
    for what, entry in zip(("grant", "delegation", "delegate"), (grant.id, *via), strict=True):
        try:
            check(entry, now)
        except HintedError as error:
            raise GrantRevoked(f"{what} {entry.hex()[:8]}: {error}", error.hint) from error
    return replace(grant, expires=opened.expires, via=via)


def _open(profile: Profile, data: bytes, key: ec.EllipticCurvePublicKey) -> bytes:
    try:
        return profile.open_body(data, key, limit=MAX_STATEMENT)
    except SignatureError as error:
        raise GrantForged(f"the {profile.typ} statement is refused: {error}") from None
    except EncodingError as error:
        raise GrantMalformed(f"not a {profile.typ} statement: {error}") from None


def _decode(body: bytes) -> Value:
    try:
        return decode(body)
    except EncodingError as error:
        raise GrantMalformed(f"not a renewal: {error}") from None


def _number(value: Any) -> int:
    if type(value) is not int:
        raise GrantMalformed("a number of the statement is of a wrong type")
    return value

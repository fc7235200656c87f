"""What a node presents: a grant as signed, one with a ticket that renews it, or a chain of narrowings.

A renewed grant is sent as the deterministic CBOR array [grant, ticket, delegation], each as signed; a chain
as [one of these, [narrowing, ...]]. A narrowing hands a grant on to another key of its domain, signed by the
holder of the link before. Every link must authorize alone, and all restrictions add up (`grants.decision`),
so a link that "grants" more has no effect. Pure; docs/spec/domains.md section 5.
"""

import hashlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any, Final, NamedTuple

from cryptography.hazmat.primitives.asymmetric import ec

from ca.encoding import MAX_SIZE, Value, decode, encode
from ca.errors import CAError, EncodingError, KeyRefused, SignatureError
from ca.keys.signing import Profile, Signer, from_coordinates, thumbprint, thumbprint_of, to_coordinates
from ca.names import split_alias
from grants import document
from grants.document import issuer_uri, open_grant, read_issuer, read_scope, scope_of, verify
from grants.errors import GrantForged, GrantForOther, GrantMalformed, GrantTooWide
from grants.model import ID_SIZE, MAX_NARROWINGS, Draft, Grant, check_time
from grants.renewal import MAX_STATEMENT, open_delegation, renew

NARROWING: Final = Profile("rossec-narrowing+cwt")
MAX_NARROWING: Final = MAX_SIZE
MAX_SINGLE: Final = MAX_SIZE + 2 * MAX_STATEMENT + 16  # a grant with what renews it
MAX_TOKEN: Final = 64 * 1024
COORDINATE: Final = 32
_ARRAY_OF_2: Final = b"\x82"
_ARRAY_OF_3: Final = b"\x83"  # a grant begins with its tag, 0xd2
_ID_PREFIX: Final = b"rossec-narrowing-id\0" + len(NARROWING.protected).to_bytes(4) + NARROWING.protected

# As in `grants.document`; these three are private use.
_ISS, _SUB, _AUD, _EXP, _NBF, _CTI, _CNF, _SCOPE, _CKT = 1, 2, 3, 4, 5, 7, 8, 9, 5
_PARENT, _KEY, _MAY_NARROW = -70032, -70033, -70034


def sign_narrowing(signer: Signer, draft: Draft, parent: Grant) -> bytes:
    """Sign `draft` as the holder of `parent`, a grant or a chain; `draft.cap` is its end."""
    from grants.conditions import check_syntax  # noqa: PLC0415 - not loaded to read grants

    for permission in draft.permissions:
        for text in permission.restriction.conditions if permission.restriction else ():
            check_syntax(text)
    key = to_coordinates(signer.public_key)
    data = NARROWING.sign(
        signer,
        {
            _ISS: issuer_uri(thumbprint(signer.public_key)),
            _SUB: draft.subject,
            _AUD: draft.domain,
            _EXP: draft.expires,
            _NBF: draft.not_before,
            _CTI: draft.serial,
            _CNF: {_CKT: draft.holder},
            _SCOPE: scope_of(draft.permissions),
            _PARENT: parent.id,
            _KEY: [key[:COORDINATE], key[COORDINATE:]],
            _MAY_NARROW: draft.may_narrow,
        },
    )
    _open_link(data, parent.links[-1])  # nothing is signed that verifiers refuse
    return data


def peek_chain(grant: Grant, narrowings: Sequence[bytes]) -> Grant:
    read = (_read(claims, body)[0] for body, claims in map(_unverified, narrowings))
    return _joined((grant, *read))


def follow(grant: Grant, narrowings: Sequence[bytes], now: int) -> Grant:
    chain = _links(grant, narrowings)
    for link in chain:
        check_time(link, now)
    return _joined(chain)


def verify_chain(grant: Grant, narrowings: Sequence[bytes]) -> Grant:
    return _joined(_links(grant, narrowings))


def check_one_domain(grant: Grant, label: str, peer: str) -> None:
    """Return if a chain stays in the domain of its first holder; a single grant always does.

    Args:
        label: what the domain that the grant is of is called here; empty: it is the own one.
        peer: the name of the peer here, an alias if it is a foreigner.
    """
    if not grant.chain:
        return
    try:
        first, found = split_alias(grant.links[0].subject), split_alias(peer)
    except CAError as error:
        raise GrantForOther(f"a chain for nobody: {error}", error.hint) from error
    found_label = "" if found is None else found[0]
    expected = label if first is None else ("" if label else first[0])
    if found_label != expected:
        raise GrantForOther(
            f"grant {grant.short_id} was narrowed for a node of another domain",
            "a right is handed on within one domain; ask for a grant of your own",
        )


def _links(grant: Grant, narrowings: Sequence[bytes]) -> tuple[Grant, ...]:
    if not 0 < len(narrowings) <= min(grant.may_narrow, MAX_NARROWINGS):
        raise GrantTooWide(
            f"grant {grant.short_id} allows {grant.may_narrow} narrowings, not {len(narrowings)}",
            "at the authority: rossec grant sign NODE --may-narrow N",
        )
    links = [grant]
    for data in narrowings:  # each with the key of the link before, so none can be left out or moved
        links.append(_open_link(data, links[-1]))
    return tuple(links)


def _joined(chain: tuple[Grant, ...]) -> Grant:
    # One grant that stands for the chain; it cannot be renewed.
    first, last = chain[0], chain[-1]
    expires = min(link.expires for link in chain)
    return replace(
        first,
        subject=last.subject,
        holder=last.holder,
        id=last.id,
        may_narrow=last.may_narrow,
        not_before=max(link.not_before for link in chain),
        expires=expires,
        cap=expires,
        via=(),
        chain=chain,
    )


def _open_link(data: bytes, before: Grant) -> Grant:
    body, claims = _unverified(data)
    try:
        match claims:
            case {-70033: [bytes() as x, bytes() as y]} if len(x) == len(y) == COORDINATE:
                named = x + y
            case _:
                raise GrantMalformed("a narrowing without the key that signed it")
        if thumbprint_of(named) != before.holder:
            raise GrantForged("a narrowing by another key than the one that holds the grant")
        NARROWING.open_body(data, _key(named), limit=MAX_NARROWING)
    except (KeyRefused, SignatureError) as error:
        raise GrantForged(f"a narrowing is refused: {error}") from None
    link, parent = _read(claims, body)
    if link.issuer != before.holder:
        raise GrantForged("a narrowing whose iss is not the key that signed it")
    if parent != before.id or link.domain != before.domain:
        raise GrantForOther(
            f"the narrowing {link.short_id} follows another grant than {before.short_id}",
            "present it with the grant it was made from",
        )
    if link.may_narrow >= before.may_narrow:
        raise GrantTooWide(
            f"{before.short_id} allows {before.may_narrow} narrowings, the one after it as many",
            "each narrowing must allow fewer than the link before",
        )
    return link


@lru_cache(maxsize=64)
def _key(coordinates: bytes) -> ec.EllipticCurvePublicKey:
    # Only keys that a verified link names come here, so a stranger drives none out.
    return from_coordinates(coordinates)


def _unverified(data: bytes) -> tuple[bytes, Value]:
    try:
        body = NARROWING.peek_body(data, limit=MAX_NARROWING)
        return body, decode(body)
    except (SignatureError, EncodingError) as error:
        raise GrantMalformed(f"not a narrowing: {error}") from None


def _read(claims: Value, body: bytes) -> tuple[Grant, bytes]:
    match claims:
        case {
            1: str() as iss,
            2: str() as sub,
            3: str() as aud,
            4: exp,
            5: nbf,
            7: bytes() as cti,
            8: {5: bytes() as ckt, **more},
            9: bytes() as scope,
            -70032: bytes() as parent,
            -70033: _,
            -70034: count,
            **rest,
        } if not rest and not more and len(parent) == ID_SIZE:
            pass
        case _:
            raise GrantMalformed("a narrowing has missing or unknown claims")
    begin, end = _number(nbf), _number(exp)
    try:
        link_id = hashlib.sha256(_ID_PREFIX + body).digest()[:ID_SIZE]
        of = (aud, sub, ckt, begin, end, end, cti, read_scope(scope), link_id, read_issuer(iss))
        link = Grant(*of, may_narrow=_number(count))
    except CAError as error:
        raise GrantMalformed(f"in a narrowing: {error}", error.hint) from None
    if link.has_tail_patterns:
        raise GrantMalformed("a narrowing with a tail pattern", "name the anonymous node")
    return link, parent


def _number(value: Any) -> int:
    if type(value) is not int:
        raise GrantMalformed("a number of a narrowing is of a wrong type")
    return value


class TokenParts(NamedTuple):
    grant: bytes
    ticket: bytes = b""  # empty for a grant without renewal, as `delegation`
    delegation: bytes = b""
    narrowings: tuple[bytes, ...] = ()  # of a chain, in order


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

        That a chain stays in one domain is checked by who knows the peer (`check_one_domain`).
        """
        parts = unpack(token)
        if not parts.ticket:
            grant = open_grant(parts.grant, self.ca_key, now, domain=self.domain)
        elif not self.delegates:
            raise GrantForOther(
                "a renewed grant, but the master's key is not known", "connect to the master first"
            )
        else:
            grant = verify(parts.grant, self.ca_key, domain=self.domain)
            delegation = open_delegation(parts.delegation, self.ca_key)
            # The delegate's key is not in the token: a peer cannot choose who renewed its grant.
            of_holder = (key for key in self.delegates if thumbprint(key) == delegation.holder)
            key = next(of_holder, self.delegates[0])  # another one's: refused as such
            grant = renew(grant, parts.ticket, delegation, key, now=now, seq=self.seq, check=self.check)
        return follow(grant, parts.narrowings, now) if parts.narrowings else grant


def pack(grant: bytes, ticket: bytes, delegation: bytes) -> bytes:
    """The token of a renewed grant."""
    return encode([grant, ticket, delegation])


def pack_chain(token: bytes, narrowings: Sequence[bytes]) -> bytes:
    """The token of a chain: `token` is that of its grant, or of a shorter chain."""
    parts = unpack(token)
    if parts.narrowings:
        token, narrowings = _split_chain(token)[0], (*parts.narrowings, *narrowings)
    packed = encode([token, [*narrowings]])
    unpack(packed)
    return packed


def unpack(token: bytes) -> TokenParts:
    """Split a token; nothing is verified. Sizes are checked before anything is parsed."""
    if token.startswith(_ARRAY_OF_2):
        single, narrowings = _split_chain(token)
        return _unpack_single(single)._replace(narrowings=narrowings)
    return _unpack_single(token)


def peek(token: bytes) -> Grant:
    """The content of a token *without* verifying it: to show or to hold it, or to find its key."""
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

"""Narrowing: the holder of a grant hands it on, restricted further, to another key of its domain.

A chain is a grant and up to three narrowings, each signed by the holder of the link before. Nothing
compares what two links say: every link must authorize alone, and all restrictions add up
(`grants.decision`), so a link that "grants" more has no effect. Who signs a narrowing is no
authority: its conditions and filters see what the links before let through, and a rate counts for
the first holder, whomever it hands the right to. Pure; docs/spec/domains.md section 4.
"""

import hashlib
from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache
from typing import Any, Final

from cryptography.hazmat.primitives.asymmetric import ec

from ca.cose import Profile
from ca.domains.aliases import split_alias
from ca.encoding import MAX_SIZE, Value, decode
from ca.errors import CAError, EncodingError, KeyRefused, SignatureError
from ca.keys.publickey import from_coordinates, thumbprint, thumbprint_of, to_coordinates
from ca.keys.signer import Signer
from grants.claims import issuer_uri, read_issuer, read_scope, scope_of
from grants.errors import (
    GrantMalformed,
    NarrowingForged,
    NarrowingForOther,
    NarrowingNotAllowed,
    NarrowingOutsideDomain,
)
from grants.model import ID_SIZE, MAX_NARROWINGS, Draft, Grant
from grants.validity import check_time

NARROWING: Final = Profile("rossec-narrowing+cwt")
MAX_NARROWING: Final = MAX_SIZE
COORDINATE: Final = 32

_ID_PREFIX: Final = (
    b"rossec-narrowing-id\0" + len(NARROWING.protected).to_bytes(4) + NARROWING.protected
)

# As in `grants.claims`; these three are private use.
_ISS, _SUB, _AUD, _EXP, _NBF, _CTI, _CNF, _SCOPE, _CKT = 1, 2, 3, 4, 5, 7, 8, 9, 5
_PARENT, _KEY, _MAY_NARROW = -70032, -70033, -70034


def sign_narrowing(signer: Signer, draft: Draft, parent: Grant) -> bytes:
    """Sign `draft` as the holder of `parent`, a grant or a chain; `draft.cap` is its end.

    Raises:
        NarrowingNotAllowed: `parent` allows none, or fewer than the draft does after it.
        NarrowingForged: the signer's key is not the one that holds `parent`.
        NarrowingForOther: the draft is for another domain.
        GrantMalformed: too large, or a condition or filter outside the language.
    """
    from grants.conditions.compile import check_syntax  # noqa: PLC0415 - not loaded to read grants

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
    """The chain as its claims say, *without* verifying a signature: to show or to hold it.

    Raises:
        GrantMalformed: outside the closed schema.
    """
    read = (_read(claims, body)[0] for body, claims in map(_unverified, narrowings))
    return _joined((grant, *read))


def follow(grant: Grant, narrowings: Sequence[bytes], now: int) -> Grant:
    """The chain of a verified grant and its narrowings, as one grant.

    Raises:
        NarrowingNotAllowed: more narrowings than the links before allow.
        NarrowingForged: not signed by the key that holds the link before.
        NarrowingForOther: it follows another link, or is for another domain.
        GrantMalformed: outside the closed schema.
        GrantNotYetValid, GrantExpired: a link is not valid at `now`.
    """
    chain = _links(grant, narrowings)
    for link in chain:
        check_time(link, now)
    return _joined(chain)


def verify_chain(grant: Grant, narrowings: Sequence[bytes]) -> Grant:
    """As `follow`, without checking times: for a chain that may be valid later."""
    return _joined(_links(grant, narrowings))


def check_one_domain(grant: Grant, label: str, peer: str) -> None:
    """Return if a chain stays in the domain of its first holder; a single grant always does.

    Args:
        label: what the domain that the grant is of is called here; empty: it is the own one.
        peer: the name of the peer here, an alias if it is a foreigner.

    Raises:
        NarrowingOutsideDomain: it was handed to another domain. The labels in a grant of a foreign
            domain are that one's: as such an alias only a node of the own domain passes.
    """
    if not grant.chain:
        return
    try:
        first, found = split_alias(grant.links[0].subject), split_alias(peer)
    except CAError as error:
        raise NarrowingOutsideDomain(f"a chain for nobody: {error}", error.hint) from error
    found_label = "" if found is None else found[0]
    expected = label if first is None else ("" if label else first[0])
    if found_label != expected:
        raise NarrowingOutsideDomain(
            f"grant {grant.short_id} was narrowed for a node of another domain",
            "a right is handed on within one domain; ask for a grant of your own",
        )


def _links(grant: Grant, narrowings: Sequence[bytes]) -> tuple[Grant, ...]:
    if not 0 < len(narrowings) <= min(grant.may_narrow, MAX_NARROWINGS):
        raise NarrowingNotAllowed(
            f"grant {grant.short_id} allows {grant.may_narrow} narrowings, not {len(narrowings)}",
            "at the authority: rossec grant sign NODE --may-narrow N",
        )
    links = [grant]
    for data in narrowings:
        links.append(_open_link(data, links[-1]))
    return tuple(links)


def _joined(chain: tuple[Grant, ...]) -> Grant:
    """One grant that stands for the chain; it cannot be renewed."""
    first, last = chain[0], chain[-1]
    expires = min(link.expires for link in chain)
    return replace(
        first, subject=last.subject, holder=last.holder, id=last.id, may_narrow=last.may_narrow,
        not_before=max(link.not_before for link in chain), expires=expires, cap=expires,
        via=(), chain=chain,
    )  # fmt: skip


def _open_link(data: bytes, before: Grant) -> Grant:
    """Verify and read one narrowing of `before`."""
    body, claims = _unverified(data)
    try:
        named = _named_key(claims)
        if thumbprint_of(named) != before.holder:
            raise NarrowingForged("a narrowing by another key than the one that holds the grant")
        NARROWING.open_body(data, _key(named), limit=MAX_NARROWING)
    except (KeyRefused, SignatureError) as error:
        raise NarrowingForged(f"a narrowing is refused: {error}") from None
    link, parent = _read(claims, body)
    if link.issuer != before.holder:
        raise NarrowingForged("a narrowing whose iss is not the key that signed it")
    if parent != before.id or link.domain != before.domain:
        raise NarrowingForOther(
            f"the narrowing {link.short_id} follows another grant than {before.short_id}",
            "present it with the grant it was made from",
        )
    if link.may_narrow >= before.may_narrow:
        raise NarrowingNotAllowed(
            f"{before.short_id} allows {before.may_narrow} narrowings, the one after it as many",
            "each narrowing must allow fewer than the link before",
        )
    return link


@lru_cache(maxsize=64)
def _key(coordinates: bytes) -> ec.EllipticCurvePublicKey:
    """The key that holds a verified link: chains are shown often, and a new key verifies slowly.

    Only keys that a verified link names come here, so a stranger drives none out.

    Raises:
        KeyRefused: not a point of the curve.
    """
    return from_coordinates(coordinates)


def _unverified(data: bytes) -> tuple[bytes, Value]:
    """The payload and its claims."""
    try:
        body = NARROWING.peek_body(data, limit=MAX_NARROWING)
        return body, decode(body)
    except (SignatureError, EncodingError) as error:
        raise GrantMalformed(f"not a narrowing: {error}") from None


def _named_key(claims: Value) -> bytes:
    """The key to verify with. The narrowing names it; that it holds the link before is checked."""
    match claims:
        case {-70033: [bytes() as x, bytes() as y]} if len(x) == len(y) == COORDINATE:
            return x + y
        case _:
            raise GrantMalformed("a narrowing without the key that signed it")


def _read(claims: Value, body: bytes) -> tuple[Grant, bytes]:
    """The link with these claims, and the id of the link before it."""
    match claims:
        case {
            1: str() as iss, 2: str() as sub, 3: str() as aud, 4: exp, 5: nbf,
            7: bytes() as cti, 8: {5: bytes() as ckt, **more}, 9: bytes() as scope,
            -70032: bytes() as parent, -70033: _, -70034: count, **rest,
        } if not rest and not more and len(parent) == ID_SIZE:  # fmt: skip
            pass
        case _:
            raise GrantMalformed("a narrowing has missing or unknown claims")
    end = _number(exp)
    try:
        link = Grant(
            aud, sub, ckt, _number(nbf), end, end, cti, read_scope(scope),
            hashlib.sha256(_ID_PREFIX + body).digest()[:ID_SIZE], read_issuer(iss),
            may_narrow=_number(count),
        )  # fmt: skip
    except CAError as error:
        raise GrantMalformed(f"in a narrowing: {error}", error.hint) from None
    if link.has_tail_patterns:
        raise GrantMalformed("a narrowing with a tail pattern", "name the anonymous node")
    return link, parent


def _number(value: Any) -> int:
    if type(value) is not int:
        raise GrantMalformed("a number of a narrowing is of a wrong type")
    return value

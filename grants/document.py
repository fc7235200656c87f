"""The signed form of a grant: a CWT (RFC 8392) in one closed COSE_Sign1 profile.

Its claims are in `claims`. The id does not include the signature: ECDSA signatures are malleable,
and a hash over one would let the holder of a revoked grant make a copy with another hash.
"""

import hashlib
from typing import Final

from cryptography.hazmat.primitives.asymmetric import ec

from ca.cose import Profile
from ca.errors import EncodingError, SignatureError
from ca.keys.publickey import thumbprint
from ca.keys.signer import Signer
from grants import claims
from grants.errors import GrantForged, GrantMalformed
from grants.model import Draft, Grant
from grants.validity import check_time

GRANT: Final = Profile("rossec-grant+cwt")

_ID_PREFIX: Final = b"rossec-grant-id\0" + len(GRANT.protected).to_bytes(4) + GRANT.protected


def sign(signer: Signer, draft: Draft) -> bytes:
    """Sign `draft` as a grant.

    Raises:
        GrantMalformed: too large, or a condition or filter outside the language.
        ConditionRefused: a condition that is not in the language.
    """
    from grants.conditions.compile import check_syntax  # noqa: PLC0415 - not loaded to read grants

    issuer = thumbprint(signer.public_key)
    for permission in draft.permissions:
        if permission.restriction is not None:
            for text in permission.restriction.conditions:
                check_syntax(text)
    data = GRANT.sign(signer, claims.from_draft(draft, issuer))
    peek(data)  # no grant is issued that verifiers refuse
    return data


def open_grant(
    data: bytes, ca_key: ec.EllipticCurvePublicKey, now: int, *, domain: str | None = None
) -> Grant:
    """Verify a grant and return its content.

    Args:
        data: the grant as received.
        ca_key: the authority's key.
        now: seconds since the epoch.
        domain: the trust domain it must be for, if one authority serves several.

    Raises:
        GrantForged: not signed by `ca_key` (for `domain`), or changed since.
        GrantMalformed: outside the closed schema.
        GrantNotYetValid, GrantExpired: not valid at `now`.
    """
    grant = verify(data, ca_key, domain=domain)
    check_time(grant, now)
    return grant


def verify(data: bytes, ca_key: ec.EllipticCurvePublicKey, *, domain: str | None = None) -> Grant:
    """As `open_grant`, without checking the time: for `grants.renewal`, which does."""
    try:
        body = GRANT.open_body(data, ca_key)
    except SignatureError as error:
        raise GrantForged(f"not a grant of this authority: {error}") from None
    except EncodingError as error:
        raise GrantMalformed(f"not a grant: {error}") from None
    grant = claims.read(body, _id(body))
    if grant.issuer != _thumbprint(ca_key):
        raise GrantForged("signed by this authority, but iss is another one")
    if domain is not None and grant.domain != domain:
        raise GrantForged(f"a grant for the trust domain {grant.domain!r}, not {domain!r}")
    return grant


def peek(data: bytes) -> Grant:
    """Return the content of a grant *without* verifying it: to show it, or to find its authority.

    Raises:
        GrantMalformed: outside the closed schema.
    """
    body = _body(data)
    return claims.read(body, _id(body))


def grant_id(data: bytes) -> bytes:
    """The 16 bytes that identify a grant: the same for every valid signature.

    Raises:
        GrantMalformed: not a grant.
    """
    body = _body(data)
    claims.decode_payload(body)
    return _id(body)


def _body(data: bytes) -> bytes:
    try:
        return GRANT.peek_body(data)
    except (SignatureError, EncodingError) as error:
        raise GrantMalformed(
            f"not a grant: {error}", "give a file that `rossec grant` wrote"
        ) from None


def _id(body: bytes) -> bytes:
    return hashlib.sha256(_ID_PREFIX + body).digest()[:16]


# The key of the last grant and its thumbprint: a node verifies all its grants with one key object.
_last_key: tuple[ec.EllipticCurvePublicKey | None, bytes] = (None, b"")


def _thumbprint(key: ec.EllipticCurvePublicKey) -> bytes:
    global _last_key  # noqa: PLW0603 - the cache of a pure function, replaced atomically
    cached, digest = _last_key
    if cached is not key:
        digest = thumbprint(key)
        _last_key = (key, digest)
    return digest

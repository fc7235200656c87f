"""The signed form of a grant: a CWT (RFC 8392) in one closed COSE_Sign1 profile, encoded in one way.

Anything unknown refuses the grant: a claim, a restriction key, a filter operator, a right bit.
"""

import base64
import hashlib
from collections.abc import Callable, Iterable
from functools import lru_cache
from typing import Any, Final

from cryptography.hazmat.primitives.asymmetric import ec

from ca.encoding import Value, decode, encode, head, parse
from ca.errors import EncodingError, NameRefused, SignatureError
from ca.keys.signing import Profile, Signer, thumbprint
from grants.errors import FilterRefused, GrantForged, GrantMalformed
from grants.model import (
    ALL_RIGHTS,
    KEY_SIZE,
    Draft,
    Grant,
    Permission,
    Restriction,
    Right,
    check_time,
    filter_rules,
)

GRANT: Final = Profile("rossec-grant+cwt")
_ID_PREFIX: Final = b"rossec-grant-id\0" + len(GRANT.protected).to_bytes(4) + GRANT.protected

# RFC 8392 section 3.1; cnf: RFC 8747; scope: RFC 9200 section 8.14, here an AIF (RFC 9237) in a
# byte string; below -65536 the numbers are for private use.
_ISS, _SUB, _AUD, _EXP, _NBF, _CTI, _CNF, _SCOPE, _CAP = 1, 2, 3, 4, 5, 7, 8, 9, -65537
_MAY_NARROW: Final = -70034
_REQUIRED: Final = {_ISS, _SUB, _AUD, _EXP, _NBF, _CTI, _CNF, _SCOPE, _CAP}
_CLAIMS: Final = {*_REQUIRED, _MAY_NARROW}
_CKT: Final = 5  # confirmation by COSE key thumbprint, RFC 9679 section 6
_CKT_URI: Final = "urn:ietf:params:oauth:ckt:sha-256:"  # RFC 9679 section 5: `iss` must be text

_TYPE, _CONDITIONS, _FILTERS, _LIMITS, _ON_STALE = 0, 1, 2, 3, 4
_RESTRICTIONS: Final = {_TYPE, _CONDITIONS, _FILTERS, _LIMITS, _ON_STALE}
_LIMIT_NAMES: Final = ("rate", "slot", "body", "pad")
_KEEP: Final = "keep"

_UINT, _BYTES, _TEXT, _MAP = 0x00, 0x40, 0x60, 0xA0  # major types


def from_draft(draft: Draft, issuer: bytes) -> Value:
    return {
        _ISS: issuer_uri(issuer),
        _SUB: draft.subject,
        _AUD: draft.domain,
        _EXP: draft.expires,
        _NBF: draft.not_before,
        _CTI: draft.serial,
        _CNF: {_CKT: draft.holder},
        _SCOPE: scope_of(draft.permissions),
        _CAP: draft.cap,
        **({_MAY_NARROW: draft.may_narrow} if draft.may_narrow else {}),
    }


def scope_of(permissions: Iterable[Permission]) -> bytes:
    """The `scope` claim: a CBOR list of AIF entries."""
    entries: list[Value] = []
    for permission in permissions:
        entry: list[Value] = [permission.pattern, int(permission.rights)]
        if (restriction := permission.restriction) is not None:
            claims: dict[int | str, Any] = {
                _TYPE: restriction.type,
                _CONDITIONS: list(restriction.conditions),
                _FILTERS: {
                    rule.path: {rule.operator: {**dict(rule.parameters)} if rule.parameters else True}
                    for rule in restriction.filters
                },
                _LIMITS: {
                    name: value for name in _LIMIT_NAMES if (value := getattr(restriction, name)) is not None
                },
                _ON_STALE: _KEEP if restriction.keep_when_stale else None,
            }
            entry.append({key: value for key, value in claims.items() if value})  # nothing in it is empty
        entries.append(entry)
    return encode(entries)


def read_claims(body: bytes, grant_id: bytes) -> Grant:
    try:
        # A grant has one encoding, so it is encoded again and compared, which costs a quarter of the general
        # check; a body that differs goes through that check, which names the error.
        read = decode_payload(body, parse)
        read = read if _deterministic_form(read) == body else decode_payload(body)
        claims = _closed_map(read, _REQUIRED, _CLAIMS, "claim")
        confirmation = _closed_map(claims[_CNF], {_CKT}, {_CKT}, "confirmation")
        may_narrow = _typed(claims.get(_MAY_NARROW, 0), int, "may_narrow")
        if _MAY_NARROW in claims and may_narrow == 0:
            raise GrantMalformed("a grant that says it allows no narrowings", "leave the claim out")
        return Grant(
            domain=_typed(claims[_AUD], str, "aud"),
            subject=_typed(claims[_SUB], str, "sub"),
            holder=_typed(confirmation[_CKT], bytes, "ckt"),
            not_before=_typed(claims[_NBF], int, "nbf"),
            expires=_typed(claims[_EXP], int, "exp"),
            cap=_typed(claims[_CAP], int, "cap"),
            serial=_typed(claims[_CTI], bytes, "cti"),
            permissions=_permissions(_typed(claims[_SCOPE], bytes, "scope")),
            id=grant_id,
            issuer=read_issuer(_typed(claims[_ISS], str, "iss")),
            may_narrow=may_narrow,
        )
    except (FilterRefused, NameRefused, EncodingError) as error:
        raise GrantMalformed(f"in a grant: {error}", error.hint) from None


def decode_payload(body: bytes, decoder: Callable[[bytes], Value] = decode) -> Value:
    try:
        return decoder(body)
    except EncodingError as error:
        raise GrantMalformed(f"not a grant: {error}") from None


def _deterministic_form(claims: Value) -> bytes | None:
    # The claims in deterministic encoding; None or other bytes if they are not the usual ones.
    # Texts are assumed to be ASCII: other texts only result in bytes that differ from the body.
    match claims:
        case {
            1: str(iss),
            2: str(sub),
            3: str(aud),
            4: int(exp),
            5: int(nbf),
            7: bytes(cti),
            8: {5: bytes(ckt)},
            9: bytes(scope),
            -65537: int(cap),
            **more,
        } if min(exp, nbf, cap) >= 0:
            count = more.get(_MAY_NARROW)
            narrowable = head(_UINT, count) if type(count) is int and count > 0 else b""
            texts = ((b"\x01", iss), (b"\x02", sub), (b"\x03", aud))
            return b"".join(
                (
                    head(_MAP, len(_REQUIRED) + bool(narrowable)),
                    *(key + head(_TEXT, len(text)) + text.encode() for key, text in texts),
                    b"\x04" + head(_UINT, exp),
                    b"\x05" + head(_UINT, nbf),
                    b"\x07\x50" + cti,
                    b"\x08\xa1\x05\x58\x20" + ckt,
                    b"\x09" + head(_BYTES, len(scope)) + scope,
                    b"\x3a\0\1\0\0" + head(_UINT, cap),
                    narrowable and b"\x3a\0\1\x11\x91" + narrowable,
                )
            )
        case _:
            return None


def read_scope(scope: bytes) -> tuple[Permission, ...]:
    """The permissions in a `scope` claim."""
    try:
        return _permissions(scope)
    except (FilterRefused, NameRefused, EncodingError) as error:
        raise GrantMalformed(f"in a scope: {error}", error.hint) from None


@lru_cache(maxsize=256)
def _permissions(scope: bytes) -> tuple[Permission, ...]:
    found: list[Permission] = []
    for entry in _typed(decode(scope), list, "scope"):
        match entry:
            case [str() as pattern, bits]:
                found.append(Permission(pattern, _rights(bits)))
            case [str() as pattern, bits, restriction]:
                found.append(Permission(pattern, _rights(bits), _restriction(restriction)))
            case _:
                raise GrantMalformed("an entry of the scope is not [pattern, rights, restrictions]")
    return tuple(found)


@lru_cache(maxsize=16)
def read_issuer(text: str) -> bytes:
    encoded = text.removeprefix(_CKT_URI)
    try:
        issuer = base64.b64decode(encoded + "=", altchars=b"-_", validate=True)
    except ValueError:
        issuer = b""
    # Compared after encoding again: base64 ignores the last bits of the last character.
    if len(issuer) != KEY_SIZE or text != issuer_uri(issuer):
        raise GrantMalformed("iss is not the thumbprint URI of a key")
    return issuer


def issuer_uri(issuer: bytes) -> str:
    """The `iss` claim for a thumbprint (RFC 9679 section 5)."""
    return _CKT_URI + base64.urlsafe_b64encode(issuer).decode().rstrip("=")


def _rights(value: Value) -> Right:
    bits = _typed(value, int, "rights")
    # Checked before the enumeration is used: Right(-1) would be all rights.
    if not 0 < bits <= int(ALL_RIGHTS):
        raise GrantMalformed(f"unknown or no right: {bits}")
    return Right(bits)


def _restriction(value: Value) -> Restriction:
    claims = _closed_map(value, set(), _RESTRICTIONS, "restriction")
    conditions = _optional(claims, _CONDITIONS, list)
    filters = _optional(claims, _FILTERS, dict)
    kind = _typed(claims[_TYPE], str, "type") if _TYPE in claims else None
    for treatment_claim in filters.values():
        _typed(treatment_claim, dict, "a filter")
    rules = filter_rules(filters)
    if rules:
        # The operators use numpy, which a process without filters need not load.
        from grants.filters.operators import treatment_for  # noqa: PLC0415 - loaded for grants with filters only

        for rule in rules:
            treatment_for(rule)
    texts = tuple(_typed(text, str, "a condition") for text in conditions)
    if claims.get(_ON_STALE, _KEEP) != _KEEP:
        raise GrantMalformed("on_stale of a grant is not keep")
    limits = _optional(claims, _LIMITS, dict)
    if unknown := limits.keys() - {*_LIMIT_NAMES}:
        raise GrantMalformed(f"unknown limit {min(map(str, unknown))[:40]} in a grant")
    rate: float | None = limits.get("rate")
    if rate is not None and type(rate) not in (int, float):
        raise GrantMalformed("rate of a grant is of a wrong type")
    slot = _typed(limits["slot"], int, "slot") if "slot" in limits else None
    body = _typed(limits["body"], str, "body") if "body" in limits else None
    pad = _typed(limits["pad"], int, "pad") if "pad" in limits else None
    stale = _ON_STALE in claims
    return Restriction(kind, texts, rules, rate, stale, slot=slot, body=body, pad=pad)


def _optional(claims: dict[Any, Any], key: int, kind: type[Any]) -> Any:
    # An optional member, never empty: one meaning, one encoding.
    if key not in claims:
        return kind()
    value = _typed(claims[key], kind, "a restriction")
    if len(value) == 0:
        raise GrantMalformed("an empty restriction")
    return value


# RFC 8392 section 3 has a generic verifier *ignore* unknown claims, so a restriction in a claim of its own
# would become an unrestricted right; restrictions are inside the scope entry they apply to.
def _closed_map(value: Value, required: set[int], allowed: set[int], what: str) -> dict[Any, Any]:
    if not isinstance(value, dict):
        raise GrantMalformed(f"the {what}s of a grant are not a map")
    if unknown := value.keys() - allowed:
        raise GrantMalformed(f"unknown {what} {min(map(str, unknown))[:40]} in a grant")
    if missing := required - value.keys():
        raise GrantMalformed(f"{what} {min(missing)} is missing in a grant")
    return value


def _typed(value: Any, kind: type[Any], what: str) -> Any:
    # Exactly this type: in Python a boolean is an integer, in a grant it is not.
    if type(value) is not kind:
        raise GrantMalformed(f"{what} of a grant is of a wrong type")
    return value


def sign(signer: Signer, draft: Draft) -> bytes:
    from grants.conditions import check_syntax  # noqa: PLC0415 - not loaded to read grants

    issuer = thumbprint(signer.public_key)
    for permission in draft.permissions:
        if permission.restriction is not None:
            for text in permission.restriction.conditions:
                check_syntax(text)
    data = GRANT.sign(signer, from_draft(draft, issuer))
    peek(data)  # no grant is issued that verifiers refuse
    return data


def open_grant(
    data: bytes, ca_key: ec.EllipticCurvePublicKey, now: int, *, domain: str | None = None
) -> Grant:
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
    grant = read_claims(body, _id(body))
    if grant.issuer != _thumbprint(ca_key):
        raise GrantForged("signed by this authority, but iss is another one")
    if domain is not None and grant.domain != domain:
        raise GrantForged(f"a grant for the trust domain {grant.domain!r}, not {domain!r}")
    return grant


def peek(data: bytes) -> Grant:
    """Return the content of a grant *without* verifying it: to show it, or to find its authority."""
    body = _body(data)
    return read_claims(body, _id(body))


def grant_id(data: bytes) -> bytes:
    """The 16 bytes that identify a grant: the same for every valid signature."""
    body = _body(data)
    decode_payload(body)
    return _id(body)


def _body(data: bytes) -> bytes:
    try:
        return GRANT.peek_body(data)
    except (SignatureError, EncodingError) as error:
        raise GrantMalformed(f"not a grant: {error}", "give a file that `rossec grant` wrote") from None


def _id(body: bytes) -> bytes:
    # Without the signature: those of ECDSA are malleable, and a hash over one would let the holder of a
    # revoked grant make a copy with another id.
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

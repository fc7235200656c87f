"""The claims of a grant, a CWT (RFC 8392): encoded in one deterministic form, decoded strictly.

Anything unknown refuses the grant: a claim, a restriction key, a filter operator, a right bit.
RFC 8392 section 3 has a generic verifier *ignore* unknown claims, so a restriction in a claim of
its own would become an unrestricted right; restrictions are inside the scope entry they apply to.
"""

import base64
from collections.abc import Callable, Iterable
from functools import lru_cache
from typing import Any, Final

from ca.encoding import Value, decode, encode, head, parse
from ca.errors import EncodingError, NameRefused
from grants.errors import FilterRefused, GrantMalformed
from grants.model import (
    ALL_RIGHTS,
    KEY_SIZE,
    Draft,
    FilterRule,
    Grant,
    Permission,
    Restriction,
    Right,
    filter_rules,
)

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
_RATE: Final = "rate"
_SLOT: Final = "slot"
_BODY: Final = "body"
_PAD: Final = "pad"
_KEEP: Final = "keep"

_UINT, _BYTES, _TEXT, _MAP = 0x00, 0x40, 0x60, 0xA0  # major types


def from_draft(draft: Draft, issuer: bytes) -> Value:
    """The claims of `draft`, to be signed by the key with the thumbprint `issuer`."""
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
    return encode([_scope_entry(permission) for permission in permissions])


def _scope_entry(permission: Permission) -> Value:
    entry: list[Value] = [permission.pattern, int(permission.rights)]
    if permission.restriction is not None:
        entry.append(_restriction_claims(permission.restriction))
    return entry


def _restriction_claims(restriction: Restriction) -> Value:
    claims: dict[int | str, Value] = {}
    if restriction.type is not None:
        claims[_TYPE] = restriction.type
    if restriction.conditions:
        claims[_CONDITIONS] = list(restriction.conditions)
    if restriction.filters:
        claims[_FILTERS] = {rule.path: _filter_claim(rule) for rule in restriction.filters}
    limits: dict[int | str, Value] = {}
    if restriction.rate is not None:
        limits[_RATE] = restriction.rate
    if restriction.slot is not None:
        limits[_SLOT] = restriction.slot
    if restriction.body is not None:
        limits[_BODY] = restriction.body
    if restriction.pad is not None:
        limits[_PAD] = restriction.pad
    if limits:
        claims[_LIMITS] = limits
    if restriction.keep_when_stale:
        claims[_ON_STALE] = _KEEP
    return claims


def _filter_claim(rule: FilterRule) -> Value:
    return {rule.operator: {**dict(rule.parameters)} if rule.parameters else True}


def read(body: bytes, grant_id: bytes) -> Grant:
    """Read the claims in `body` as the grant `grant_id`.

    Raises:
        GrantMalformed: outside the closed schema; errors in its parts are reported as this one.
    """
    try:
        return _read_grant(_closed_map(_decode_claims(body), _REQUIRED, _CLAIMS, "claim"), grant_id)
    except (FilterRefused, NameRefused, EncodingError) as error:
        raise GrantMalformed(f"in a grant: {error}", error.hint) from None


def decode_payload(body: bytes, decoder: Callable[[bytes], Value] = decode) -> Value:
    """Decode a payload in deterministic encoding.

    Raises:
        GrantMalformed: not deterministically encoded CBOR.
    """
    try:
        return decoder(body)
    except EncodingError as error:
        raise GrantMalformed(f"not a grant: {error}") from None


def _decode_claims(body: bytes) -> Value:
    """The claims, decoded strictly.

    A grant has one encoding, so it is encoded again and compared, which costs a quarter of the
    general check; a body that differs goes through that check, which names the error.
    """
    claims = decode_payload(body, parse)
    return claims if _deterministic_form(claims) == body else decode_payload(body)


def _deterministic_form(claims: Value) -> bytes | None:
    """The claims in deterministic encoding; None or other bytes if they are not the usual ones.

    Texts are assumed to be ASCII: other texts only result in bytes that differ from the body.
    """
    match claims:
        case {
            1: str(iss), 2: str(sub), 3: str(aud), 4: int(exp), 5: int(nbf), 7: bytes(cti),
            8: {5: bytes(ckt)}, 9: bytes(scope), -65537: int(cap), **more,
        } if min(exp, nbf, cap) >= 0:  # fmt: skip
            count = more.get(_MAY_NARROW)
            narrowable = head(_UINT, count) if type(count) is int and count > 0 else b""
            return b"".join(
                (
                    head(_MAP, len(_REQUIRED) + bool(narrowable)),
                    b"\x01", head(_TEXT, len(iss)), iss.encode(),
                    b"\x02", head(_TEXT, len(sub)), sub.encode(),
                    b"\x03", head(_TEXT, len(aud)), aud.encode(),
                    b"\x04", head(_UINT, exp), b"\x05", head(_UINT, nbf),
                    b"\x07\x50", cti, b"\x08\xa1\x05\x58\x20", ckt,
                    b"\x09", head(_BYTES, len(scope)), scope,
                    b"\x3a\0\1\0\0", head(_UINT, cap),
                    narrowable and b"\x3a\0\1\x11\x91" + narrowable,
                )
            )  # fmt: skip
        case _:
            return None


def _read_grant(claims: dict[Any, Any], grant_id: bytes) -> Grant:
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


def read_scope(scope: bytes) -> tuple[Permission, ...]:
    """The permissions in a `scope` claim.

    Raises:
        GrantMalformed: outside the closed schema.
    """
    try:
        return _permissions(scope)
    except (FilterRefused, NameRefused, EncodingError) as error:
        raise GrantMalformed(f"in a scope: {error}", error.hint) from None


@lru_cache(maxsize=256)
def _permissions(scope: bytes) -> tuple[Permission, ...]:
    """The permissions in a scope. Many grants have the same scope, and are presented often."""
    return tuple(_permission(entry) for entry in _typed(decode(scope), list, "scope"))


@lru_cache(maxsize=16)
def read_issuer(text: str) -> bytes:
    """The thumbprint in an `iss` claim.

    Raises:
        GrantMalformed: not exactly a thumbprint URI.
    """
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


def _permission(entry: Value) -> Permission:
    match entry:
        case [str() as pattern, bits]:
            return Permission(pattern, _rights(bits))
        case [str() as pattern, bits, restriction]:
            return Permission(pattern, _rights(bits), _restriction(restriction))
        case _:
            pass
    raise GrantMalformed("an entry of the scope is not [pattern, rights, restrictions]")


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
    rate, slot, body, pad = _limits(claims)
    stale = _ON_STALE in claims
    return Restriction(kind, texts, rules, rate, stale, slot=slot, body=body, pad=pad)


def _limits(claims: dict[Any, Any]) -> tuple[float | None, int | None, str | None, int | None]:
    limits = _optional(claims, _LIMITS, dict)
    if unknown := limits.keys() - {_RATE, _SLOT, _BODY, _PAD}:
        raise GrantMalformed(f"unknown limit {min(map(str, unknown))[:40]} in a grant")
    rate: float | None = limits.get(_RATE)
    if rate is not None and type(rate) not in (int, float):
        raise GrantMalformed("rate of a grant is of a wrong type")
    slot = _typed(limits[_SLOT], int, "slot") if _SLOT in limits else None
    body = _typed(limits[_BODY], str, "body") if _BODY in limits else None
    pad = _typed(limits[_PAD], int, "pad") if _PAD in limits else None
    return rate, slot, body, pad


def _optional(claims: dict[Any, Any], key: int, kind: type[Any]) -> Any:
    """An optional member, never empty: one meaning, one encoding."""
    if key not in claims:
        return kind()
    value = _typed(claims[key], kind, "a restriction")
    if len(value) == 0:
        raise GrantMalformed("an empty restriction")
    return value


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

"""Renewal: a valid identity requests its successor, without operator action.

The request is a CSR for the same name, inside a statement signed by the *old* key: the CSR proves
possession of the new key, the statement the right to the name. Its type is in the signed header, so
nothing else the key signs is a renewal. The key may stay the same (and keeps its grants) or be new.
The authority's rules are here as well: the old identity is valid and not revoked, the name is the
same, at least half of the lifetime is over, and the new lifetime is not longer than the old one.

A node writes its new key to the disk *before* it sends the request, and repeats the same bytes
until it has the answer: the authority answers one request always with the same certificate.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

from ca.certificates import Identity, TrustAnchor
from ca.cose import Profile
from ca.encoding import Value
from ca.errors import EncodingError, RenewalRefused, SignatureError
from ca.keys.signer import Signer
from ca.requests import MAX_REQUEST, IdentityRequest, check_request
from ca.svid import MAX_CERTIFICATE

PROFILE: Final = Profile("rossec-renewal+cwt")
MAX_CHAIN: Final = 2
MAX_RENEWAL: Final = MAX_REQUEST + MAX_CHAIN * MAX_CERTIFICATE + 512
MAX_AGE: Final = 300  # seconds: two clocks and a slow network
# Certificates are backdated by this much: the clock of robots without a battery-backed one may be
# behind after a start.
BACKDATE: Final = 3600
_IAT, _CSR, _CHAIN = 6, -70021, -70022


@dataclass(frozen=True)
class Renewal:
    """A verified renewal: the current identity, and the request."""

    identity: Identity
    request: IdentityRequest
    csr: bytes

    @property
    def max_lifetime(self) -> int:
        """The lifetime (seconds) of the identity, which the successor's may not exceed."""
        return self.identity.not_after - signed_at(
            self.identity.not_before, self.identity.not_after
        )


def signed_at(not_before: int, not_after: int) -> int:
    """When an identity was signed: the backdated hour is not part of its lifetime.

    Otherwise each successor would live an hour longer, and a short one would be due at once.
    """
    began = not_before + BACKDATE
    return began if began < not_after else not_before


def renew_at(not_before: int, not_after: int) -> int:
    """When to renew: after two thirds of an identity's lifetime."""
    began = signed_at(not_before, not_after)
    return began + (not_after - began) * 2 // 3


def retry_delay(not_before: int, not_after: int, longest: int) -> int:
    """Seconds to wait after a refusal, at most `longest`; a twentieth of a short lifetime."""
    life = not_after - signed_at(not_before, not_after)
    return max(1, min(longest, life // 20))


def sign_renewal(old: Signer, chain: Sequence[bytes], csr: bytes, now: int) -> bytes:
    """Sign, with the old key, the request that `csr` succeed `chain` (DER, leaf first)."""
    certificates: list[Value] = [*chain]
    return PROFILE.sign(old, {_IAT: now, _CSR: csr, _CHAIN: certificates})


def open_renewal(
    data: bytes, anchor: TrustAnchor, now: int, check: Callable[[bytes, int], None]
) -> Renewal:
    """Return the renewal in `data`, if it is valid.

    `check(entry, now)` raises when a key's thumbprint is revoked, or its status is unknown
    (`Revocations.check`).

    Raises:
        RenewalRefused: malformed, not signed by the identity, too old, for another name, or early.
        CertificateRefused: the old identity is invalid: expired, or of another authority.
        RequestRefused: the CSR is invalid.
        Revoked, RevocationsStale: what `check` raises.
    """
    _, _, chain = _read(_peek(data))
    identity = anchor.verify(chain, now)
    issued, csr, _ = _read(_open(data, identity))
    for key in identity.keys:
        check(key, now)
    if not now - MAX_AGE <= issued <= now + MAX_AGE:
        raise RenewalRefused("the renewal is too old, or from the future", "check both clocks")
    request = check_request(csr, anchor.domain, wildcard=identity.wildcard)
    if request.name != identity.name:
        raise RenewalRefused(
            f"{identity.name} requests the identity of {request.name}",
            "a node renews its own name; for another one it must be enrolled",
        )
    _check_due(identity, now)
    return Renewal(identity, request, csr)


def _check_due(identity: Identity, now: int) -> None:
    began = signed_at(identity.not_before, identity.not_after)
    half = began + (identity.not_after - began) // 2
    if now < half:
        raise RenewalRefused(
            f"the identity of {identity.name} is not due for renewal for {half - now} s",
            "possible after half its lifetime; before that, where the authority is:"
            f" rossec ca renew {identity.name}",
        )


def _peek(data: bytes) -> Value:
    try:
        return PROFILE.peek(data, limit=MAX_RENEWAL)
    except (SignatureError, EncodingError) as error:
        raise RenewalRefused(f"this is not a renewal: {error}") from error


def _open(data: bytes, identity: Identity) -> Value:
    try:
        return PROFILE.open(data, identity.public_key, limit=MAX_RENEWAL)
    except (SignatureError, EncodingError) as error:
        raise RenewalRefused(
            f"the renewal is not signed by {identity.name}: {error}",
            "renew on the node that has the key",
        ) from error


def _read(value: Value) -> tuple[int, bytes, tuple[bytes, ...]]:
    match value:
        case {6: int() as issued, -70021: bytes() as csr, -70022: list() as items, **rest} if (
            not rest and not isinstance(issued, bool) and 1 <= len(items) <= MAX_CHAIN
        ):
            chain = tuple(item for item in items if isinstance(item, bytes))
        case _:
            raise RenewalRefused("the renewal has missing or unknown fields")
    if len(chain) != len(items):
        raise RenewalRefused("the renewal's chain is not a list of certificates")
    return issued, csr, chain

"""Renewal: an identity that is still good asks for its successor, without a person.

The request is a CSR for the same name, inside a statement signed by the *old* key: the CSR proves
the new key, the statement the right to the name. Its kind is in the signed header, so nothing else
the key ever signs is a renewal. The key may stay the same (grants are for a key, and it keeps them)
or be new. The signer's rules are here as well: the old identity valid and not revoked, the same
name, at least half of its life spent, and never a longer life than it had.

A node writes its new key to the disk *before* it asks, and repeats the same bytes until it has the
answer: the authority answers one request once, always with the same certificate.
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
# Certificates begin so long before they are signed: robots without a battery-backed clock start a
# little in the past.
BACKDATE: Final = 3600
_IAT, _CSR, _CHAIN = 6, -70021, -70022


@dataclass(frozen=True)
class Renewal:
    """A checked renewal: who it is now, and what it asks for."""

    identity: Identity
    request: IdentityRequest
    csr: bytes

    @property
    def max_lifetime(self) -> int:
        """The longest life (seconds) the successor may have: that of the identity it succeeds."""
        return self.identity.not_after - signed_at(
            self.identity.not_before, self.identity.not_after
        )


def signed_at(not_before: int, not_after: int) -> int:
    """When an identity's life began: the backdated hour is no part of it.

    If it were, each successor would live an hour longer, and a short one be due at once.
    """
    began = not_before + BACKDATE
    return began if began < not_after else not_before


def renew_at(not_before: int, not_after: int) -> int:
    """When to ask: two thirds of an identity's life are over."""
    began = signed_at(not_before, not_after)
    return began + (not_after - began) * 2 // 3


def retry_delay(not_before: int, not_after: int, longest: int) -> int:
    """Seconds to wait after a refusal, at most `longest`: a short life leaves time for a few."""
    life = not_after - signed_at(not_before, not_after)
    return max(1, min(longest, life // 20))


def sign_renewal(old: Signer, chain: Sequence[bytes], csr: bytes, now: int) -> bytes:
    """Ask, with the old key, that `csr` succeeds the identity of `chain` (DER, leaf first)."""
    certificates: list[Value] = [*chain]
    return PROFILE.sign(old, {_IAT: now, _CSR: csr, _CHAIN: certificates})


def open_renewal(
    data: bytes, anchor: TrustAnchor, now: int, check: Callable[[bytes, int], None]
) -> Renewal:
    """Return the renewal `data` asks for, if it is in order.

    `check(entry, now)` raises when a key's thumbprint is revoked, or nobody can tell
    (`Revocations.check`).

    Raises:
        RenewalRefused: malformed, not signed by the identity, too old, for another name, or early.
        CertificateRefused: the old identity is not valid: expired, or a stranger's.
        RequestRefused: the CSR is not in order.
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
            f"{identity.name} asks for the identity of {request.name}",
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
            "renewals begin at half its life; sooner, an operator can: rossec ca renew NAME",
        )


def _peek(data: bytes) -> Value:
    try:
        return PROFILE.peek(data, limit=MAX_RENEWAL)
    except (SignatureError, EncodingError) as error:
        raise RenewalRefused(f"this is no renewal: {error}") from error


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
        raise RenewalRefused("the renewal's chain is not of certificates")
    return issued, csr, chain

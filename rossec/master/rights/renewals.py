"""Renewals for the authority: of grants, within what it delegated, and of identities. Pure.

The delegation names the master's key, the trust domain, and the longest validity of a ticket. A
ticket is signed for a grant that its holder presents, expired or not, as long as its cap is not
reached and nothing is revoked. The master of a domain signs no identities, unless its host holds an
intermediate: it verifies a request and keeps it, one for each key; the authority's service fetches
requests, decides by its record, and leaves the answers here, where nodes find them when they ask
again. Nothing is written to the disk: a node goes on asking, and gets one certificate however often.
"""

import hashlib
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, NamedTuple

from ca.certificates import (
    MAX_AGE,
    MAX_RENEWAL,
    Identity,
    Renewal,
    TrustAnchor,
    from_pem,
    open_renewal,
    retry_delay,
)
from ca.errors import CAError, CertificateRefused, RenewalRefused
from ca.keys.signing import Signer, thumbprint
from ca.revocation.trust_status import SKEW
from grants import renewal
from grants.decision import RevocationCheck
from grants.document import verify
from grants.errors import GrantForOther, GrantNotHeld, GrantTooWide, RenewalNotInTime
from grants.model import Grant, format_time
from grants.renewal import OpenDelegation, Ticket, open_delegation, sign_ticket
from grants.token import pack, unpack

_HINT: Final = "at the authority: rossec master delegate"


class TicketSigner:
    """Signs tickets while the authority has delegated that; `persist` is called before it takes effect."""

    def __init__(
        self, anchor: TrustAnchor, signer: Signer, persist: Callable[[bytes], object] = lambda _data: None
    ) -> None:
        self._anchor = anchor
        self._signer = signer
        self._own = thumbprint(signer.public_key)
        self._persist = persist
        self._data = b""
        self._held: OpenDelegation | None = None

    def take(self, data: bytes) -> bool:
        new = open_delegation(data, self._anchor.public_key)
        if new.holder != self._own or new.domain != self._anchor.domain:
            raise GrantForOther("the delegation is for another key or trust domain than this master's", _HINT)
        if self._held is not None and new.not_before <= self._held.not_before:
            return False
        self._persist(data)
        self._held, self._data = new, data
        return True

    @property
    def id(self) -> bytes | None:
        return None if self._held is None else self._held.id

    def renew(
        self, token: bytes, holder: bytes, now: int, *, seq: int, check: RevocationCheck
    ) -> tuple[Grant, bytes]:
        # The renewed grant is verified as every node will.
        if self._held is None:
            raise RenewalNotInTime("the authority has not delegated renewal to this master", _HINT)
        data = unpack(token).grant
        grant = verify(data, self._anchor.public_key, domain=self._anchor.domain)
        if grant.holder != holder:
            raise GrantNotHeld("the grant is bound to another key", f"it was issued to {grant.subject}")
        if now >= grant.cap:
            raise GrantTooWide(
                f"grant {grant.short_id} has reached its cap, {format_time(grant.cap)}",
                "ask the authority for a new grant",
            )
        if now >= self._held.expires:
            raise RenewalNotInTime(f"the delegation expired at {format_time(self._held.expires)}", _HINT)
        ends = min(now - SKEW + self._held.max_ttl, grant.cap, self._held.expires)
        if ends <= grant.expires:
            raise GrantTooWide(f"grant {grant.short_id} expires later than any ticket would: ask again later")
        ticket = sign_ticket(self._signer, Ticket(grant.id, now - SKEW, ends, seq))
        key = self._signer.public_key
        renewed = renewal.renew(grant, ticket, self._held, key, now=now, seq=seq, check=check)
        return renewed, pack(data, ticket, self._data)


Renewer = Callable[[bytes, int, RevocationCheck], bytes]
"""Answers a renewal request (`ca.certificates`) with the node's new bundle."""

MAX_KEPT: Final = 4096  # keys
OFFER_LIMIT: Final = 16  # requests in one answer to the authority's service
MAX_REASON: Final = 1024
OFFERED_AGAIN: Final = 30  # seconds after which a request without an answer is offered once more
ANSWER_KEPT: Final = 1800  # seconds
SPACING: Final = 60  # seconds at most between an answer and the next request of the same key
VERIFY_SPACING: Final = 2  # seconds for which a waiting request is not verified again
AUTHORITY_SEEN: Final = 60  # seconds for which the authority's service counts as there

_ASKED: Final = "the authority's service has been asked; the answer is here in a moment"
_LOCKED: Final = "the authority's key is locked (where the authority is: rossec ca unlock --for 8h)"
_AWAY: Final = (
    "the authority's service does not run, or does not reach this master (where the authority is:"
    " rossec ca serve, and rossec ca unlock --for 8h)"
)
_SOON: Final = "it was renewed a moment ago; ask again later"


class RenewalAnswer(NamedTuple):
    """The new bundle (PEM); empty: there is none yet, and `status` says what is waited for."""

    bundle: bytes
    status: str


class RenewalOffer(NamedTuple):
    requests: list[bytes]
    waiting: int


class Settlement(NamedTuple):
    """What was decided of the request with this SHA-256: a bundle, or the reason why there is none."""

    digest: bytes
    bundle: bytes
    reason: str


@dataclass(slots=True)
class _Entry:
    name: str
    wildcard: bool
    key: bytes  # of the certificate that is asked for
    request: bytes
    verified_at: int
    ends: int
    next_request_at: int
    offered_at: int | None = None
    offered: bytes = b""
    bundle: bytes = b""
    not_after: int = 0
    reason: str = ""
    is_told: bool = False

    @property
    def is_answered(self) -> bool:
        return bool(self.bundle or self.reason)


class IdentityRenewals:
    """The table, by the key that asks."""

    def __init__(self, anchor: TrustAnchor, renewer: Renewer | None = None) -> None:
        self._anchor = anchor
        self._renewer = renewer  # renews at once, with an intermediate; None: the authority's service does
        self._entries: dict[bytes, _Entry] = {}
        self._seen_at: int | None = None
        self._is_locked = False
        # called when there is a request that the service has not seen
        self.on_asked: Callable[[], object] = lambda: None
        # called with the key whose request is answered
        self.on_answered: Callable[[bytes], object] = lambda _key: None

    def waiting(self, now: int) -> int:
        return sum(not each.is_answered and _is_kept(each, now) for each in self._entries.values())

    def ask(self, holder: bytes, request: bytes, now: int, check: RevocationCheck) -> RenewalAnswer:
        if self._renewer is not None:
            return RenewalAnswer(self._renewer(request, now, check), "identity renewed")
        if len(request) > MAX_RENEWAL:
            raise RenewalRefused("a renewal that is too long")
        entry = self._entries.get(holder)
        entry = entry if entry is not None and _is_kept(entry, now) else None
        is_waiting = entry is not None and not entry.is_answered
        if entry is not None and is_waiting and 0 <= now - entry.verified_at < VERIFY_SPACING:
            return self._later(now)
        renewal = open_renewal(request, self._anchor, now, check)
        if renewal.identity.thumbprint != holder:
            raise RenewalRefused(
                f"this connection is not of {renewal.identity.name}", "each node renews its own"
            )
        if entry is not None and entry.key == renewal.request.thumbprint:
            if entry.reason and not (entry.is_told and now >= entry.next_request_at):
                entry.is_told = True
                raise RenewalRefused(entry.reason)
            if entry.not_after > renewal.identity.not_after:
                return RenewalAnswer(entry.bundle, "identity renewed")
        return self._place(holder, entry, renewal, request, now)

    def offer(self, now: int, *, locked: bool) -> RenewalOffer:
        self._seen_at, self._is_locked = now, locked
        self._prune(now)
        waiting = [each for each in self._entries.values() if not each.is_answered]
        due = [each for each in waiting if _is_due(each, now)][: 0 if locked else OFFER_LIMIT]
        for each in due:
            each.offered_at, each.offered = now, hashlib.sha256(each.request).digest()
        return RenewalOffer([each.request for each in due], len(waiting))

    def settle(self, found: list[Settlement], now: int, check: RevocationCheck) -> int:
        # An answer to no request, or with another certificate than was asked for, is left out.
        offered = {each.offered: key for key, each in self._entries.items() if each.offered}
        settled = 0
        for each in found:
            holder = offered.get(each.digest)
            entry = None if holder is None else self._entries[holder]
            if holder is None or entry is None or entry.is_answered:
                continue
            if each.reason:
                entry.reason = each.reason[:MAX_REASON]
            else:
                try:
                    identity = self._verify(entry, each.bundle, now, check)
                except CAError:
                    continue
                entry.bundle, entry.not_after = each.bundle, identity.not_after
            entry.ends = now + ANSWER_KEPT
            settled += 1
            self.on_answered(holder)
        return settled

    def _place(
        self, holder: bytes, entry: _Entry | None, renewal: Renewal, request: bytes, now: int
    ) -> RenewalAnswer:
        if entry is not None and not entry.is_answered and entry.key == renewal.request.thumbprint:
            entry.request, entry.verified_at, entry.ends = request, now, now + MAX_AGE
            if _is_due(entry, now):
                self.on_asked()
            return self._later(now)
        if entry is not None and now < entry.next_request_at:
            return RenewalAnswer(b"", _SOON)
        self._prune(now)
        if holder not in self._entries and len(self._entries) >= MAX_KEPT:
            raise RenewalRefused(
                f"the master keeps {MAX_KEPT} requests for renewals and takes no more",
                "where the authority is: rossec ca unlock --for 8h",
            )
        held = renewal.identity
        pause = retry_delay(held.not_before, held.not_after, SPACING)
        self._entries[holder] = _Entry(
            held.name, held.wildcard, renewal.request.thumbprint, request, now, now + MAX_AGE, now + pause
        )
        self.on_asked()
        return self._later(now)

    def _later(self, now: int) -> RenewalAnswer:
        if self._seen_at is None or not 0 <= now - self._seen_at < AUTHORITY_SEEN:
            return RenewalAnswer(b"", _AWAY)
        return RenewalAnswer(b"", _LOCKED if self._is_locked else _ASKED)

    def _verify(self, entry: _Entry, bundle: bytes, now: int, check: RevocationCheck) -> Identity:
        *chain, root = from_pem(bundle)
        identity = self._anchor.verify(chain, now)
        found = identity.name, identity.wildcard, identity.thumbprint
        if root != self._anchor.certificate or found != (entry.name, entry.wildcard, entry.key):
            raise CertificateRefused(f"not the identity that {entry.name} asked for")
        for key in identity.keys:
            check(key, now)
        return identity

    def _prune(self, now: int) -> None:
        for holder in [key for key, each in self._entries.items() if not _is_kept(each, now)]:
            del self._entries[holder]


def _is_kept(entry: _Entry, now: int) -> bool:
    # Whether it counts: what a clock that was ahead has left would be in the way for as long.
    return entry.verified_at - MAX_AGE <= now < entry.ends


def _is_due(entry: _Entry, now: int) -> bool:
    # Whether the service is to see it: it did not yet, or did not answer.
    return entry.offered_at is None or not 0 <= now - entry.offered_at < OFFERED_AGAIN

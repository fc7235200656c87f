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

from ca.certificates import MAX_AGE, MAX_RENEWAL, TrustAnchor, from_pem, open_renewal, retry_delay
from ca.errors import CAError
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
        # The steps of docs/spec/revocation.md, section 5. 1. The authority's leave, and its signature.
        if self._held is None:
            raise RenewalNotInTime("the authority has not delegated renewal to this master", _HINT)
        data = unpack(token).grant
        grant = verify(data, self._anchor.public_key, domain=self._anchor.domain)
        # 2. Only for the holder.
        if grant.holder != holder:
            raise GrantNotHeld("the grant is bound to another key", f"it was issued to {grant.subject}")
        # 3. Not past its cap; that it has expired is no reason: a robot that was off needs no operator.
        if now >= grant.cap:
            cap = format_time(grant.cap)
            hint = "ask the authority for a new grant"
            raise GrantTooWide(f"grant {grant.short_id} has reached its cap, {cap}", hint)
        if now >= self._held.expires:
            raise RenewalNotInTime(f"the delegation expired at {format_time(self._held.expires)}", _HINT)
        # 4. From 5 s ago, as clocks differ, to what comes first.
        ends = min(now - SKEW + self._held.max_ttl, grant.cap, self._held.expires)
        if ends <= grant.expires:
            later = "expires later than any ticket would: ask again later"
            raise GrantTooWide(f"grant {grant.short_id} {later}")
        ticket = sign_ticket(self._signer, Ticket(grant.id, now - SKEW, ends, seq))
        # 5. Verified as every node will, with what is revoked.
        key = self._signer.public_key
        renewed = renewal.renew(grant, ticket, self._held, key, now=now, seq=seq, check=check)
        return renewed, pack(data, ticket, self._data)


# Answers a renewal request (`ca.certificates`) with the node's new bundle
Renewer = Callable[[bytes, int, RevocationCheck], bytes]
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

    def ask(  # noqa: C901 - the steps of the specification
        self, holder: bytes, request: bytes, now: int, check: RevocationCheck
    ) -> RenewalAnswer:
        # docs/spec/revocation.md, section 5. 1. At once, where there is an intermediate.
        if self._renewer is not None:
            return RenewalAnswer(self._renewer(request, now, check), "identity renewed")
        # 2. What costs nothing first: a request is verified by several signatures, and a node asks often.
        if len(request) > MAX_RENEWAL:
            raise CAError("a renewal that is too long")
        entry = self._entries.get(holder)
        entry = entry if entry is not None and _is_kept(entry, now) else None
        waiting = entry if entry is not None and not entry.is_answered else None
        if waiting is not None and 0 <= now - waiting.verified_at < VERIFY_SPACING:
            return self._later(now)
        # 3. The request is of the key of the connection it came by.
        renewal = open_renewal(request, self._anchor, now, check)
        held, key = renewal.identity, renewal.request.thumbprint
        if held.thumbprint != holder:
            raise CAError(f"this connection is not of {held.name}", "each node renews its own")
        # 4. There is an answer; after a refusal that was told, and a pause, the node may ask anew.
        if entry is not None and entry.key == key:
            if entry.reason and not (entry.is_told and now >= entry.next_request_at):
                entry.is_told = True
                raise CAError(entry.reason)
            if entry.not_after > held.not_after:
                return RenewalAnswer(entry.bundle, "identity renewed")
        # 5. The same request is waiting, or another one comes too soon after the last.
        if waiting is not None and waiting.key == key:
            waiting.request, waiting.verified_at, waiting.ends = request, now, now + MAX_AGE
            if _is_due(waiting, now):
                self.on_asked()
            return self._later(now)
        if entry is not None and now < entry.next_request_at:
            return RenewalAnswer(b"", _SOON)
        # 6. It is kept, one for each key, and the service is told.
        self._prune(now)
        if holder not in self._entries and len(self._entries) >= MAX_KEPT:
            full = f"the master keeps {MAX_KEPT} requests for renewals and takes no more"
            raise CAError(full, "where the authority is: rossec ca unlock --for 8h")
        next_at = now + retry_delay(held.not_before, held.not_after, SPACING)
        self._entries[holder] = _Entry(held.name, held.wildcard, key, request, now, now + MAX_AGE, next_at)
        self.on_asked()
        return self._later(now)

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
                    *chain, root = from_pem(each.bundle)
                    identity = self._anchor.verify(chain, now)
                    given = identity.name, identity.wildcard, identity.thumbprint
                    asked = entry.name, entry.wildcard, entry.key
                    if root != self._anchor.certificate or given != asked:
                        continue
                    for key in identity.keys:
                        check(key, now)
                except CAError:
                    continue
                entry.bundle, entry.not_after = each.bundle, identity.not_after
            entry.ends = now + ANSWER_KEPT
            settled += 1
            self.on_answered(holder)
        return settled

    def _later(self, now: int) -> RenewalAnswer:
        if self._seen_at is None or not 0 <= now - self._seen_at < AUTHORITY_SEEN:
            return RenewalAnswer(b"", _AWAY)
        return RenewalAnswer(b"", _LOCKED if self._is_locked else _ASKED)

    def _prune(self, now: int) -> None:
        for holder in [key for key, each in self._entries.items() if not _is_kept(each, now)]:
            del self._entries[holder]


def _is_kept(entry: _Entry, now: int) -> bool:
    # Whether it counts: what a clock that was ahead has left would be in the way for as long.
    return entry.verified_at - MAX_AGE <= now < entry.ends


def _is_due(entry: _Entry, now: int) -> bool:
    # Whether the service is to see it: it did not yet, or did not answer.
    return entry.offered_at is None or not 0 <= now - entry.offered_at < OFFERED_AGAIN

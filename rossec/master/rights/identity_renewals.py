"""Identities that nodes ask to have renewed: kept until the authority's service has answered. Pure.

The master of a domain signs no identities, unless its host holds an intermediate. It verifies what
a node asks for and keeps it, one request for each key; the authority's service fetches requests,
decides by its record, and leaves the answers here, where nodes find them when they ask again.
Nothing is written to the disk: a node goes on asking, and gets one certificate however often.
"""

import hashlib
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, NamedTuple

from ca.certificates import Identity, TrustAnchor, from_pem
from ca.errors import CAError, CertificateRefused, RenewalRefused
from ca.renewal import MAX_AGE, MAX_RENEWAL, Renewal, open_renewal, retry_delay
from grants.decision import RevocationCheck

Renewer = Callable[[bytes, int, RevocationCheck], bytes]
"""Answers a renewal request (`ca.renewal`) with the node's new bundle."""

MAX_KEPT: Final = 4096  # keys
OFFER_LIMIT: Final = 16  # requests in one answer to the authority's service
MAX_REASON: Final = 1024
OFFERED_AGAIN: Final = 30  # seconds after which a request without an answer is offered once more
ANSWER_KEPT: Final = 1800  # seconds: nodes of older versions ask every 600
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


class Offer(NamedTuple):
    """Requests for the authority's service, and how many wait in all."""

    requests: list[bytes]
    waiting: int


class Settlement(NamedTuple):
    """What the authority's service decided of the request with this SHA-256.

    Either a bundle, or the reason why there is none.
    """

    digest: bytes
    bundle: bytes
    reason: str


@dataclass(slots=True)
class _Entry:
    """What is kept of one key: a request, then its answer."""

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
    """The table, by the key that asks.

    Args:
        anchor: the authority.
        renewer: renews at once, with an intermediate; None: the authority's service does.

    Attributes:
        on_asked: called when there is a request that the service has not seen.
        on_answered: called with the key whose request is answered.
    """

    def __init__(self, anchor: TrustAnchor, renewer: Renewer | None = None) -> None:
        self._anchor = anchor
        self._renewer = renewer
        self._entries: dict[bytes, _Entry] = {}
        self._seen_at: int | None = None
        self._is_locked = False
        self.on_asked: Callable[[], None] = _ignore
        self.on_answered: Callable[[bytes], None] = _ignore_key

    def waiting(self, now: int) -> int:
        """How many requests have no answer yet."""
        return sum(not each.is_answered and _is_kept(each, now) for each in self._entries.values())

    def ask(self, holder: bytes, request: bytes, now: int, check: RevocationCheck) -> RenewalAnswer:
        """Answer what the peer with the key `holder` asks for; `check` raises for revoked keys.

        Raises:
            CAError: it is refused, by this master or by the authority.
        """
        if self._renewer is not None:
            return RenewalAnswer(self._renewer(request, now, check), "identity renewed")
        if len(request) > MAX_RENEWAL:
            raise RenewalRefused("a renewal that is too long")
        entry = self._current(holder, now)
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

    def offer(self, now: int, *, locked: bool) -> Offer:
        """What the authority's service, which asks, has to decide; nothing while it is `locked`."""
        self._seen_at, self._is_locked = now, locked
        self._prune(now)
        waiting = [each for each in self._entries.values() if not each.is_answered]
        due = [each for each in waiting if _is_due(each, now)][: 0 if locked else OFFER_LIMIT]
        for each in due:
            each.offered_at, each.offered = now, hashlib.sha256(each.request).digest()
        return Offer([each.request for each in due], len(waiting))

    def settle(self, found: list[Settlement], now: int, check: RevocationCheck) -> int:
        """Keep the answers to what was offered; returns to how many.

        An answer to no request, or with another certificate than was asked for, is left out.
        """
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

    def _current(self, holder: bytes, now: int) -> _Entry | None:
        entry = self._entries.get(holder)
        return entry if entry is not None and _is_kept(entry, now) else None

    def _place(
        self, holder: bytes, entry: _Entry | None, renewal: Renewal, request: bytes, now: int
    ) -> RenewalAnswer:
        """Keep a request, in the place of what there is of its key."""
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
            held.name, held.wildcard, renewal.request.thumbprint, request, now, now + MAX_AGE,
            now + pause,
        )  # fmt: skip
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
    """Whether it counts: what a clock that was ahead has left would be in the way for as long."""
    return entry.verified_at - MAX_AGE <= now < entry.ends


def _is_due(entry: _Entry, now: int) -> bool:
    """Whether the service is to see it: it did not yet, or did not answer."""
    return entry.offered_at is None or not 0 <= now - entry.offered_at < OFFERED_AGAIN


def _ignore() -> None:
    """Nobody waits."""


def _ignore_key(_holder: bytes) -> None:
    """Likewise."""

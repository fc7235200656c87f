"""When a live connection must end: its grant or key is revoked or expired, or nobody knows.

Pure: the shell asks about each link and cuts it. A link is what was admitted by a decision.
"""

from typing import Final, Protocol

from ca.certificates import Identity
from ca.errors import RevocationsStale, Revoked
from ca.revocation.state import Revocations
from grants.decision import Decision
from rossec.net.aio import SecureStream

# Existing connections survive missing timestamps this long; new ones are refused at once.
STALE_GRACE: Final = 60


class AuthenticatedPeer(Protocol):
    """A stream whose peer is authenticated."""

    @property
    def peer(self) -> Identity:
        """Who is at the other end."""


class AuthorizedPeer(Protocol):
    """A connection admitted by `decision`; grant or certificate expire at `ends` (seconds)."""

    decision: Decision
    ends: int

    @property
    def stream(self) -> AuthenticatedPeer:
        """The connection."""


class AuthorizedConnection(AuthorizedPeer, Protocol):
    """A connection of the built-in node, which its watch can cut."""

    @property
    def stream(self) -> SecureStream[Identity]:
        """The connection."""


def termination_reason(link: AuthorizedPeer, revocations: Revocations, now: int) -> str | None:
    """Why `link` must be cut now, or None while it may live.

    Missing news of revocations cuts after a while, unless every permission of the link says
    `on_stale: keep`: an emergency stop must not depend on them. A revocation always cuts.
    """
    if now >= link.ends:
        return "its grant or its certificate has expired"
    reasons = {entry: _trouble(entry, revocations, now) for entry in _entries(link)}
    for reason in reasons.values():  # before staleness, which the first meets as well as the last
        if isinstance(reason, Revoked):
            return str(reason)
    if link.decision.keep_when_stale:
        return None
    for entry, reason in reasons.items():
        if reason is not None and now >= revocations.status_valid_until(entry) + STALE_GRACE:
            return str(reason)
    return None


def _entries(link: AuthorizedPeer) -> tuple[bytes, ...]:
    return (*link.stream.peer.keys, *link.decision.grant_ids)


def _trouble(entry: bytes, revocations: Revocations, now: int) -> Revoked | RevocationsStale | None:
    try:
        revocations.check(entry, now)
    except (Revoked, RevocationsStale) as error:
        return error
    return None

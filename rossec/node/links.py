"""When a live connection must end: its grant or key is revoked or expired, or nobody knows.

Pure: the shell asks about each link and cuts it. A link is what was admitted by a decision.
"""

from typing import Final, Protocol

from ca.certificates import Identity
from ca.errors import RevocationsStale, Revoked
from ca.revocation import Revocations
from grants.decision import Decision
from rossec.net.stream import SecureStream

# Existing connections survive missing timestamps this long; new ones are refused at once.
STALE_GRACE: Final = 60


class Proven(Protocol):
    """A stream whose peer is authenticated."""

    @property
    def peer(self) -> Identity:
        """Who is at the other end."""


class Judged(Protocol):
    """A connection admitted by `decision`; grant or certificate expire at `ends` (seconds)."""

    decision: Decision
    ends: int

    @property
    def stream(self) -> Proven:
        """The connection."""


class Link(Judged, Protocol):
    """A connection of the built-in node, which its watch can cut."""

    @property
    def stream(self) -> SecureStream[Identity]:
        """The connection."""


def why_cut(link: Judged, revocations: Revocations, now: int) -> str | None:
    """Why `link` must be cut now, or None while it may live."""
    if now >= link.ends:
        return "its grant or its certificate has expired"
    try:
        for entry in (*link.stream.peer.keys, *link.decision.grant_ids):
            revocations.check(entry, now)
    except Revoked as error:
        return str(error)
    except RevocationsStale as error:
        return str(error) if now >= revocations.fresh_until + STALE_GRACE else None
    return None

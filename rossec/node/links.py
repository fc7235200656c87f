"""The live connections of a node, and which of them must end now.

Pure: a revoked grant or key, an expiry, or a stale revocation list names the links to cut; the
shell cuts them. A link is anything with grant ids, the peer's key and an end.
"""

from collections.abc import Iterable, Iterator
from typing import Generic, Protocol, TypeVar

from grants.decision import Decision

# Existing connections survive missing timestamps this long; new ones are refused at once.
STALE_GRACE = 60


class Link(Protocol):
    """A connection that was admitted by `decision`, to the key `thumbprint`, until `ends` (seconds)."""

    decision: Decision
    thumbprint: bytes
    ends: int


L = TypeVar("L", bound=Link)


class Links(Generic[L]):
    """A set of links; every question about them is answered from it, nothing is removed by asking."""

    def __init__(self) -> None:
        self._links: set[L] = set()

    def __iter__(self) -> Iterator[L]:
        return iter(tuple(self._links))

    def __len__(self) -> int:
        return len(self._links)

    def add(self, link: L) -> None:
        """Start to watch `link`."""
        self._links.add(link)

    def discard(self, link: L) -> None:
        """Stop watching `link`; it need not be known."""
        self._links.discard(link)

    def revoked(self, entries: Iterable[bytes]) -> list[L]:
        """Links that rest on one of the revoked grant ids or key thumbprints."""
        gone = frozenset(entries)
        return [
            link
            for link in self._links
            if link.thumbprint in gone or not gone.isdisjoint(link.decision.grant_ids)
        ]

    def expired(self, now: float) -> list[L]:
        """Links whose grant or certificate has ended."""
        return [link for link in self._links if link.ends <= now]

    def stale(self, fresh_until: float, now: float) -> list[L]:
        """Every link, once revocations have been unknown for longer than the grace time."""
        return list(self._links) if now > fresh_until + STALE_GRACE else []

    def next_end(self) -> int | None:
        """The earliest second at which a link expires."""
        return min((link.ends for link in self._links), default=None)

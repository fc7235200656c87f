"""A connection whose peer was authorized: under which decision, until when, and what ends it.

The decision may be replaced while it is open, by one on grants that the peer presents later.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from itertools import product
from typing import Final, Generic, Protocol, TypeVar

from ca.certificates import Identity
from ca.domains.aliases import split_alias
from ca.domains.served import alias_of_served
from ca.domains.standing import Standing
from ca.errors import NotAdmitted, RevocationsStale, Revoked
from grants.decision import Decision
from rossec import clock

# Existing connections survive missing timestamps this long; new ones are refused at once.
STALE_GRACE: Final = 60


class PeerStream(Protocol):
    """A stream whose peer is authenticated."""

    @property
    def peer(self) -> Identity:
        """Identity of the peer."""

    def pad_units(self, multiple: int) -> None:
        """Pad what is sent from now on to a multiple of so many bytes; 0: do not."""

    def abort(self, reason: str) -> None:
        """End it at once; from any thread, if threads share the table."""


StreamT = TypeVar("StreamT", bound=PeerStream)
GuardT = TypeVar("GuardT")


@dataclass
class Presented:
    """What was presented on one open connection.

    Attributes:
        by_peer: its newest grants, which may not be in force (yet); empty: none since the header.
        retry_at: when they are judged again; None: they were accepted, or there are none.
        pause: seconds until they are judged once more after that.
        by_self: the newest grants of this node; empty: those of its header, if any.
        version: of this node's rights, when `by_self` was compared with them; below 0: never.
        next_at: when this node may present again.
        opened: when the connection was authorized.
    """

    by_peer: bytes = b""
    retry_at: int | None = None
    pause: int = 0
    by_self: bytes = b""
    version: int = -1
    next_at: int = 0
    opened: int = field(default_factory=clock.now)


@dataclass(eq=False)
class AuthorizedConnection(Generic[StreamT, GuardT]):
    """A connection admitted by `decision`.

    Attributes:
        guard: applies the restrictions of the decision to what passes; None: nothing does here.
        rebuild: makes the guard for another decision of the same peer, right and name; it raises a
            `HintedError` where that cannot be applied to this connection. None: it takes none.
        swap: puts another guard in the place of the one in force; None: it is this attribute.
        presented: what both sides have presented since it is open.
        ends: when the grant or the certificate of the peer expires (seconds).
    """

    stream: StreamT
    decision: Decision
    guard: GuardT
    rebuild: Callable[[Decision], GuardT] | None = None
    swap: Callable[[GuardT], None] | None = None
    presented: Presented = field(default_factory=Presented)
    ends: int = field(init=False)

    def __post_init__(self) -> None:
        self.update_end()
        if self.decision.pad:
            self.stream.pad_units(self.decision.pad)

    def update_end(self) -> None:
        """The decision or the peer's certificate is another one."""
        self.ends = min(self.decision.expires, self.stream.peer.not_after)

    def replace(self, decision: Decision, guard: GuardT) -> None:
        """Another decision, with its guard, takes the place of the one in force.

        The guard first: a thread that sends meanwhile filters by it, and ends by either. What it
        sends is padded, if one of the two says so.
        """
        if decision.pad > self.decision.pad:
            self.stream.pad_units(decision.pad)
        if self.swap is not None:
            self.swap(guard)
        self.guard = guard
        if decision.pad < self.decision.pad:
            self.stream.pad_units(decision.pad)
        self.decision = decision
        self.update_end()

    def termination_reason(self, standing: Standing, now: int) -> str | None:
        """Why it must be closed now; None while it may stay open.

        The peer's keys count on the own list and on that of its domain; the grants' entries also on
        that of the domain the name is of. Missing revocation data closes it after `STALE_GRACE`,
        unless every permission used says `on_stale: keep`: an emergency stop must not depend on it.
        A revocation, and the end of the trust in a domain, always close it.
        """
        if now >= self.ends:
            return "its grant or its certificate has expired"
        errors = {entry: _error_of(*entry, standing, now) for entry in self._entries(standing)}
        for error in errors.values():  # all of them before staleness, which the first may have too
            if isinstance(error, Revoked | NotAdmitted):
                return str(error)
        try:
            standing.check_trust(self.stream.peer, now)
            _check_label(self.decision, standing)
        except NotAdmitted as error:
            return str(error)
        if self.decision.keep_when_stale:
            return None
        for entry, stale in errors.items():
            if stale is not None and now >= standing.status_valid_until(*entry) + STALE_GRACE:
                return str(stale)
        return None

    def _entries(self, standing: Standing) -> Iterator[tuple[str, bytes]]:
        """What ends it when revoked, with the domain whose list says so."""
        peer, own = self.stream.peer, standing.anchors.own.domain
        of_peer = dict.fromkeys((own, peer.domain))
        of_grants = of_peer | dict.fromkeys(grant.domain for grant in self.decision.grants)
        yield from product(of_peer, peer.keys)
        yield from product(of_grants, self.decision.grant_ids)


def _error_of(
    domain: str, entry: bytes, standing: Standing, now: int
) -> Revoked | NotAdmitted | RevocationsStale | None:
    try:
        standing.check(domain, entry, now)
    except (Revoked, NotAdmitted, RevocationsStale) as error:
        return error
    return None


def _check_label(decision: Decision, standing: Standing) -> None:
    """Return while the label in an alias stands for the domain of the grants.

    What a gateway serves is of the own domain's grants, and ends with the label. Whose label it is
    then, the gateway's own connections to the origin have been cut for.
    """
    served = alias_of_served(decision.name)
    found = split_alias(decision.name if served is None else served)
    if found is None:
        return
    listed = standing.anchors.listed(found[0])
    if served is not None and listed is not None:
        return
    domain = None if listed is None else listed.entry.domain
    if any(grant.domain != domain for grant in decision.grants):
        raise NotAdmitted(f"{found[0]} is no longer the domain it was")

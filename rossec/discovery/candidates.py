"""The masters announced on the local links, the best one first.

Pure: datagrams, sources and times in. Cheap checks come first: size, form, age, duplicates; only
then is a signature verified, within `rossec.discovery.budget`. A chain that verified is cached for
a while. An announcement counts once for each link: a replay from another address is a duplicate.
A forger can only cause probes that fail.
"""

from collections import Counter, OrderedDict, deque
from dataclasses import dataclass, field
from typing import Final

from ca.certificates import Identity, TrustAnchor
from rossec.discovery.announcement import Announcement, Claim, read_claim
from rossec.discovery.budget import Budget
from rossec.errors import AnnouncementRefused

MAX_CANDIDATES: Final = 16
_SEEN: Final = 1024
_WINDOW: Final = 16  # announcements over which loss is measured
_SLOWEST: Final = 2.0  # seconds between announcements, until two have arrived
_LOSS_STEP: Final = 0.25  # a smaller difference is chance
_CHAIN_LIFE: Final = 60.0  # seconds for which a chain is not verified again
_MAX_REASONS: Final = 32
_OTHER: Final = "other reasons"


@dataclass(frozen=True)
class DatagramSource:
    """Where a datagram came from: an address with its scope, and the link it arrived on."""

    address: str
    link: int


@dataclass
class Candidate:
    """One master on one link. `rtt` is None until a probe has reached it."""

    key: bytes
    name: str
    source: DatagramSource
    announcement: Announcement
    heard: deque[tuple[int, float]] = field(default_factory=lambda: deque(maxlen=_WINDOW))
    rtt: float | None = None
    endpoint: tuple[str, int] | None = None

    @property
    def endpoints(self) -> tuple[tuple[str, int], ...]:
        """Addresses to probe: the announced one, then the source of the announcement."""
        port = self.announcement.port
        return (self.announcement.host, port), (self.source.address, port)

    @property
    def ends(self) -> int:
        """The second after which it is forgotten, without another announcement."""
        return self.announcement.issued + self.announcement.max_age

    def age(self, clock: float) -> float:
        """Seconds since the last announcement."""
        return max(0.0, clock - self.heard[-1][1])

    def sent(self, clock: float) -> int:
        """How many announcements it has sent since the first one in `heard`.

        By sequence number up to the last one received; after it by time, so that the loss of a
        master that has died grows. Half an interval late does not count as lost.
        """
        (first, began), (last, ended) = self.heard[0], self.heard[-1]
        interval = (ended - began) / (last - first) if last > first else _SLOWEST
        missed = int(self.age(clock) / max(interval, 0.1) - 0.5)
        return last - first + 1 + max(0, missed)

    def loss(self, clock: float) -> float:
        """The share of these announcements that did not arrive, 0 to 1."""
        return 1 - len(self.heard) / self.sent(clock)

    def quality(self, clock: float) -> tuple[bool, float, float, str]:
        """The lower the better: reached at all, loss in coarse steps, the time a probe took."""
        rtt = float("inf") if self.rtt is None else self.rtt
        return self.rtt is None, self.loss(clock) // _LOSS_STEP, rtt, self.source.address


class Candidates:
    """All announcements received by one node."""

    def __init__(self, anchor: TrustAnchor, revoked: frozenset[bytes] = frozenset()) -> None:
        self._anchor = anchor
        self._revoked = revoked
        self._candidates: dict[tuple[bytes, DatagramSource], Candidate] = {}
        self._seen: OrderedDict[tuple[bytes, int, int], None] = OrderedDict()
        self._newest: dict[bytes, Announcement] = {}
        self._chains: OrderedDict[tuple[bytes, ...], tuple[Identity, float]] = OrderedDict()
        self._budget: Budget = Budget()
        self.refused: Counter[str] = Counter()

    def heard(
        self, data: bytes, source: DatagramSource, now: int, clock: float
    ) -> Candidate | None:
        """Process a datagram; returns the master it is from, None for a duplicate.

        Args:
            now: seconds since the epoch.
            clock: seconds of a monotonic clock.

        Raises:
            AnnouncementRefused: counted in `refused` by its message.
        """
        try:
            return self._heard(data, source, now, clock)
        except AnnouncementRefused as error:
            why = str(error)
            full = len(self.refused) >= _MAX_REASONS  # reasons quote untrusted certificates
            self.refused[_OTHER if full and why not in self.refused else why] += 1
            raise

    def probed(self, candidate: Candidate, endpoint: tuple[str, int], seconds: float) -> None:
        """A connection to `endpoint` was answered after `seconds`; the shortest time counts."""
        if candidate.rtt is None or seconds < candidate.rtt:
            candidate.rtt, candidate.endpoint = seconds, endpoint

    def ranked(self, now: int, clock: float) -> list[Candidate]:
        """The current masters, the best first; those no probe has reached are last."""
        self._forget(now)
        return sorted(self._candidates.values(), key=lambda one: one.quality(clock))

    def best(self, now: int, clock: float) -> Candidate | None:
        """The best master that a probe has reached."""
        return next((one for one in self.ranked(now, clock) if one.rtt is not None), None)

    def _heard(
        self, data: bytes, source: DatagramSource, now: int, clock: float
    ) -> Candidate | None:
        claim = read_claim(data, now)
        if self._is_repeated(claim.announcement, source):
            return None
        identity = self._identity(claim, source, now, clock)
        announcement = claim.verify(identity)
        self._budget.note_verified(source)
        self._remember(announcement, source)
        self._check_newer(identity.thumbprint, announcement)
        return self._take(identity, source, announcement, now, clock)

    def _identity(self, claim: Claim, source: DatagramSource, now: int, clock: float) -> Identity:
        """Verify the chain of the claim, or use the cached identity; charges the budget."""
        identity, until = self._chains.get(claim.chain, (None, 0.0))
        if identity is not None and clock < until:
            self._budget.spend(source, 1, clock, known_chain=True)
            return identity
        self._budget.spend(source, 1 + len(claim.chain), clock, known_chain=False)
        identity = claim.verify_chain(self._anchor, self._revoked, now)
        self._chains[claim.chain] = identity, clock + _CHAIN_LIFE
        if len(self._chains) > MAX_CANDIDATES:
            self._chains.popitem(last=False)
        return identity

    def _take(
        self,
        identity: Identity,
        source: DatagramSource,
        announcement: Announcement,
        now: int,
        clock: float,
    ) -> Candidate:
        self._forget(now)
        key = identity.thumbprint
        found = self._candidates.get((key, source))
        if found is None and len(self._candidates) >= MAX_CANDIDATES:
            raise AnnouncementRefused("more masters announce themselves than the limit allows")
        if found is None or found.announcement.instance != announcement.instance:
            found = self._candidates[key, source] = Candidate(
                key, identity.name, source, announcement
            )
        found.announcement = announcement
        found.heard.append((announcement.seq, clock))
        return found

    def _forget(self, now: int) -> None:
        self._candidates = {key: one for key, one in self._candidates.items() if now <= one.ends}

    def _is_repeated(self, announcement: Announcement, source: DatagramSource) -> bool:
        """Whether one with these numbers has verified: another is a duplicate, or forged."""
        return (announcement.instance, announcement.seq, source.link) in self._seen

    def _remember(self, announcement: Announcement, source: DatagramSource) -> None:
        self._seen[announcement.instance, announcement.seq, source.link] = None
        if len(self._seen) > _SEEN:
            self._seen.popitem(last=False)

    def _check_newer(self, key: bytes, announcement: Announcement) -> None:
        """Sequence numbers only rise, and a new instance is later than the previous one."""
        newest = self._newest.get(key)
        if newest is not None:
            same = newest.instance == announcement.instance
            older = announcement.seq < newest.seq if same else announcement.issued < newest.issued
            if older:
                raise AnnouncementRefused("an announcement older than one received before")
        self._newest[key] = announcement

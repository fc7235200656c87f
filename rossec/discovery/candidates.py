"""The masters heard on the local links, the best one first, and which one is kept.

Pure: datagrams, sources and times in. The signature is what costs, so it is checked at most
`RATE` times a second, and an announcement counts once for each link: who repeats somebody else's
from an address of its own comes too late. What a forger can still do is to be tried in vain.
"""

from collections import Counter, OrderedDict, deque
from dataclasses import dataclass, field
from typing import Final

from ca.certificates import TrustAnchor
from rossec.discovery.announcement import Announcement, open_announcement
from rossec.errors import AnnouncementRefused

RATE: Final = 20.0  # signatures checked in a second, and at once
MAX_CANDIDATES: Final = 16
_SEEN: Final = 256
_WINDOW: Final = 8  # announcements over which loss is measured
_LOSS_STEP: Final = 0.25  # a smaller difference is chance


@dataclass(frozen=True)
class Source:
    """Where a datagram came from: an address with its scope, and the link it arrived on."""

    address: str
    link: int


@dataclass
class Candidate:
    """One master as heard on one link. `rtt` is None until a probe has reached it."""

    key: bytes
    source: Source
    announcement: Announcement
    heard: deque[int] = field(default_factory=lambda: deque(maxlen=_WINDOW))
    rtt: float | None = None
    endpoint: tuple[str, int] | None = None

    @property
    def endpoints(self) -> tuple[tuple[str, int], ...]:
        """Where to knock: as it calls itself, then where it was heard."""
        port = self.announcement.port
        return (self.announcement.host, port), (self.source.address, port)

    @property
    def ends(self) -> int:
        """The second after which it is forgotten, unless it is heard again."""
        return self.announcement.issued + self.announcement.max_age

    @property
    def loss(self) -> float:
        """The share of its last announcements that did not arrive, 0 to 1."""
        span = self.heard[-1] - self.heard[0] + 1
        return 1 - len(self.heard) / span

    @property
    def quality(self) -> tuple[float, float, str]:
        """The lower the better: loss in coarse steps, then the time a probe took."""
        rtt = float("inf") if self.rtt is None else self.rtt
        return self.loss // _LOSS_STEP, rtt, self.source.address


class Candidates:
    """Everything heard by one node."""

    def __init__(self, anchor: TrustAnchor, revoked: frozenset[bytes] = frozenset()) -> None:
        self._anchor = anchor
        self._revoked = revoked
        self._held: dict[tuple[bytes, Source], Candidate] = {}
        self._seen: OrderedDict[tuple[bytes, int, int], None] = OrderedDict()
        self._newest: dict[bytes, Announcement] = {}
        self._allowance, self._refilled = RATE, 0.0
        self.refused: Counter[str] = Counter()

    def heard(self, data: bytes, source: Source, now: int, clock: float) -> Candidate | None:
        """Take a datagram; returns the master it is from, None when it tells nothing new.

        Args:
            now: seconds since the epoch.
            clock: seconds of a clock that only runs forward.

        Raises:
            AnnouncementRefused: counted in `refused` by its message.
        """
        try:
            return self._heard(data, source, now, clock)
        except AnnouncementRefused as error:
            self.refused[str(error)] += 1
            raise

    def probed(self, candidate: Candidate, endpoint: tuple[str, int], seconds: float) -> None:
        """A connection to `endpoint` was answered after `seconds`; the shortest time counts."""
        if candidate.rtt is None or seconds < candidate.rtt:
            candidate.rtt, candidate.endpoint = seconds, endpoint

    def ranked(self, now: int) -> list[Candidate]:
        """The masters still heard, the best first; those no probe has reached are last."""
        self._held = {key: one for key, one in self._held.items() if now <= one.ends}
        return sorted(self._held.values(), key=lambda one: (one.rtt is None, one.quality))

    def best(self, now: int) -> Candidate | None:
        """The best master that a probe has reached."""
        return next((one for one in self.ranked(now) if one.rtt is not None), None)

    def _heard(self, data: bytes, source: Source, now: int, clock: float) -> Candidate | None:
        self._spend(clock)
        announcement, identity = open_announcement(data, self._anchor, self._revoked, now)
        if self._is_repeated(announcement, source):
            return None
        self._check_newer(identity.thumbprint, announcement)
        self.ranked(now)
        key = (identity.thumbprint, source)
        if key not in self._held and len(self._held) >= MAX_CANDIDATES:
            raise AnnouncementRefused("more masters announce themselves than can be remembered")
        held = self._held.get(key)
        if held is None or held.announcement.instance != announcement.instance:
            held = self._held[key] = Candidate(identity.thumbprint, source, announcement)
        held.announcement = announcement
        held.heard.append(announcement.seq)
        return held

    def _spend(self, clock: float) -> None:
        earned = max(0.0, clock - self._refilled) * RATE
        self._allowance, self._refilled = min(RATE, self._allowance + earned), clock
        if self._allowance < 1:
            raise AnnouncementRefused("more announcements than can be checked")
        self._allowance -= 1

    def _is_repeated(self, announcement: Announcement, source: Source) -> bool:
        seen = (announcement.instance, announcement.seq, source.link)
        if seen in self._seen:
            return True
        self._seen[seen] = None
        if len(self._seen) > _SEEN:
            self._seen.popitem(last=False)
        return False

    def _check_newer(self, key: bytes, announcement: Announcement) -> None:
        """Numbers only rise, and a new instance is later than the one before it."""
        newest = self._newest.get(key)
        if newest is not None:
            same = newest.instance == announcement.instance
            older = announcement.seq < newest.seq if same else announcement.issued < newest.issued
            if older:
                raise AnnouncementRefused("an announcement older than one heard before")
        self._newest[key] = announcement

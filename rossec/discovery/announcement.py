"""Masters announced on the local links: signed datagrams, and the candidates they make. Pure.

An announcement carries the certificate chain that verifies it, so that a new node needs only its
trust anchor. It gives the address of the master, nothing more: the peer there still has to
authenticate in the handshake, so a forger can only cause probes that fail.
"""

from collections import Counter, deque
from collections.abc import Hashable
from dataclasses import dataclass, field
from typing import Final

from ca import encoding, names
from ca.bounded import ExpiringTable, Newest
from ca.certificates import Identity, TrustAnchor
from ca.errors import CAError
from ca.keys.signing import Profile, Signer
from grants.limits import TokenBucket
from rossec.errors import AnnouncementRefused
from rossec.peer_limits import printable

PROFILE: Final = Profile("rossec-announcement+cwt")
MAX_SIZE: Final = 1232  # IPv6's smallest MTU, less its own and UDP's header (RFC 8200 section 5)
MAX_AGE: Final = 15
SKEW: Final = 5
INSTANCE_SIZE: Final = 8
_MAX_HOST: Final = 255
_MAX_CHAIN: Final = 2
_VERSION_LIMIT: Final = 1 << 31  # as XML-RPC's integers
_IAT, _CHAIN = 6, 33
_MAX_AGE, _HOST, _PORT, _INSTANCE, _SEQ, _VERSION = -70005, -70011, -70012, -70013, -70014, -70015
SHARE: Final = 50.0  # verified in a second, and at once, for one address
TOTAL: Final = 200.0  # the same for all addresses without a verified announcement
MAX_SOURCES: Final = 1024
MAX_VERIFIED: Final = 64
MAX_CANDIDATES: Final = 16
_SEEN: Final = 1024
_WINDOW: Final = 16  # announcements over which loss is measured
_SLOWEST: Final = 2.0  # seconds between announcements, until two have arrived
_LOSS_STEP: Final = 0.25  # a smaller difference is chance
_CHAIN_LIFE: Final = 60.0  # seconds for which a chain is not verified again
_MAX_REASONS: Final = 32
_OTHER: Final = "other reasons"


@dataclass(frozen=True)
class Announcement:
    host: str  # its name or address, as for ROS clients
    port: int  # its TCP port
    instance: bytes  # 8 random bytes, new at every start
    seq: int  # counts the announcements of one instance
    issued: int  # issued, max_age: seconds; it is valid until `issued + max_age`
    max_age: int = MAX_AGE
    version: int = 0  # of its graph, a hint to ask it now


def sign(signer: Signer, chain: tuple[bytes, ...], announcement: Announcement) -> bytes:
    _check(announcement)
    certificates: list[encoding.Value] = [*chain]
    data = PROFILE.sign(
        signer,
        {
            _IAT: announcement.issued,
            _MAX_AGE: announcement.max_age,
            _HOST: announcement.host,
            _PORT: announcement.port,
            _INSTANCE: announcement.instance,
            _SEQ: announcement.seq,
            _VERSION: announcement.version,
            _CHAIN: certificates,
        },
    )
    if len(data) > MAX_SIZE:
        raise AnnouncementRefused(
            f"an announcement of {len(data)} bytes does not fit a datagram of {MAX_SIZE}",
            "name the master by its address (ROS_IP), which is shorter",
        )
    return data


@dataclass(frozen=True)
class MasterClaim:
    data: bytes
    announcement: Announcement
    chain: tuple[bytes, ...]

    def verify_chain(self, anchor: TrustAnchor, revoked: frozenset[bytes], now: int) -> Identity:
        try:
            identity = anchor.verify(self.chain, now)
        except CAError as error:
            raise _foreign(error) from error
        if identity.is_foreign or not names.is_master_name(identity.name):
            raise AnnouncementRefused(f"{identity.name} announces itself as a master")
        # Also its intermediate: what that signed is revoked with it.
        if not revoked.isdisjoint(identity.keys):
            raise AnnouncementRefused("the master that announces itself is revoked")
        return identity

    def verify(self, identity: Identity) -> Announcement:
        try:
            PROFILE.open_body(self.data, identity.public_key, limit=MAX_SIZE)
        except CAError as error:
            raise _foreign(error) from error
        return self.announcement


def read_claim(data: bytes, now: int) -> MasterClaim:
    try:
        announcement, chain = _read(PROFILE.peek(data, limit=MAX_SIZE))
    except CAError as error:
        raise _foreign(error) from error
    # What was recorded counts for 15 s at most (`forged-announcement`).
    if announcement.issued > now + SKEW or announcement.issued + announcement.max_age < now:
        raise AnnouncementRefused("an announcement of another time", "check both clocks")
    return MasterClaim(data, announcement, tuple(chain))


def _foreign(error: CAError) -> AnnouncementRefused:
    return AnnouncementRefused(f"no announcement of this domain's master: {error}")


def _read(payload: encoding.Value) -> tuple[Announcement, list[bytes]]:
    match payload:
        case {
            6: int() as issued,
            -70005: int() as max_age,
            -70011: str() as host,
            -70012: int() as port,
            -70013: bytes() as instance,
            -70014: int() as seq,
            -70015: int() as version,
            33: list() as items,
            **rest,
        } if not rest:
            announcement = Announcement(host, port, instance, seq, issued, max_age, version)
        case _:
            raise AnnouncementRefused("the announcement has missing or unknown fields")
    _check(announcement)
    chain = [item for item in items if isinstance(item, bytes)]
    if not 1 <= len(items) <= _MAX_CHAIN or len(chain) != len(items):
        raise AnnouncementRefused("the announcement carries no certificate chain")
    return announcement, chain


def _check(announcement: Announcement) -> None:
    version = announcement.version
    numbers = (version, announcement.port, announcement.seq, announcement.issued, announcement.max_age)
    if any(isinstance(number, bool) or number < 0 for number in numbers):
        raise AnnouncementRefused("a number in the announcement is out of range")
    if not 0 < announcement.port < 1 << 16 or not 1 <= announcement.max_age <= MAX_AGE:
        raise AnnouncementRefused("the announcement's port or age is out of range")
    if version >= _VERSION_LIMIT:
        raise AnnouncementRefused("the announcement's version is out of range")
    if len(announcement.instance) != INSTANCE_SIZE:
        raise AnnouncementRefused(f"the announcement's instance has not {INSTANCE_SIZE} bytes")
    host = announcement.host
    # It is shown to people and logged: a line break in it would forge lines.
    if not 0 < len(host) <= _MAX_HOST or printable(host) != host or any(c in host for c in " /@"):
        raise AnnouncementRefused("the announcement's host is not a name or address")


class Budget:
    """How many signatures of unknown senders are verified in a second.

    Verifying costs a tenth of a millisecond here and a millisecond on a small robot. An address has
    a token bucket of its own; all addresses together have one for new chains, and one for chains
    that verified before; an address from which an announcement *verified* uses its own alone.
    """

    def __init__(self, share: float = SHARE, total: float = TOTAL) -> None:
        self._share = share
        self._shares: Newest[Hashable, TokenBucket] = Newest(MAX_SOURCES)
        self._verified: Newest[Hashable, TokenBucket] = Newest(MAX_VERIFIED)
        self._totals = {known: TokenBucket(total, total) for known in (True, False)}

    def spend(self, source: Hashable, cost: int, clock: float, *, known_chain: bool) -> None:
        # A flood from one address, or from many, must not keep out a master that was heard before.
        buckets = (
            [self._verified[source]]
            if source in self._verified
            else [self._of(source), self._totals[known_chain]]
        )
        if not all(bucket.refill(clock) >= cost for bucket in buckets):
            raise AnnouncementRefused("more announcements than can be checked")
        for bucket in buckets:
            bucket.tokens -= cost

    def note_verified(self, source: Hashable) -> None:
        if source not in self._verified:
            self._verified[source] = self._of(source)

    def _of(self, source: Hashable) -> TokenBucket:
        bucket = self._shares[source] = self._shares.get(source) or TokenBucket(self._share, self._share)
        return bucket


@dataclass(frozen=True)
class DatagramSource:
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
        port = self.announcement.port
        return (self.announcement.host, port), (self.source.address, port)

    @property
    def ends(self) -> int:
        return self.announcement.issued + self.announcement.max_age

    def age(self, clock: float) -> float:
        return max(0.0, clock - self.heard[-1][1])

    def sent(self, clock: float) -> int:
        """How many announcements it has sent since the first one in `heard`."""
        # By sequence number up to the last one received; after it by time, so that the loss of a master that
        # has died grows. Half an interval late does not count as lost.
        (first, began), (last, ended) = self.heard[0], self.heard[-1]
        interval = (ended - began) / (last - first) if last > first else _SLOWEST
        missed = int(self.age(clock) / max(interval, 0.1) - 0.5)
        return last - first + 1 + max(0, missed)

    def loss(self, clock: float) -> float:
        return 1 - len(self.heard) / self.sent(clock)

    def quality(self, clock: float) -> tuple[bool, float, float, str]:
        rtt = float("inf") if self.rtt is None else self.rtt
        return self.rtt is None, self.loss(clock) // _LOSS_STEP, rtt, self.source.address


class Candidates:
    """All announcements received by one node.

    One counts once for each link: a replay from another address is a duplicate.
    """

    def __init__(self, anchor: TrustAnchor, revoked: frozenset[bytes] = frozenset()) -> None:
        self._anchor = anchor
        self._revoked = revoked
        self._candidates: dict[tuple[bytes, DatagramSource], Candidate] = {}
        self._seen: Newest[tuple[bytes, int, int], None] = Newest(_SEEN)
        self._newest: dict[bytes, Announcement] = {}
        self._chains: ExpiringTable[tuple[bytes, ...], Identity] = ExpiringTable(MAX_CANDIDATES, _CHAIN_LIFE)
        self._budget: Budget = Budget()
        self.refused: Counter[str] = Counter()

    def heard(self, data: bytes, source: DatagramSource, now: int, clock: float) -> Candidate | None:
        """Process a datagram; returns the master it is from, None for a duplicate."""
        # `now` is since the epoch, `clock` of a monotonic clock.
        try:
            # 1. Cheap checks first (`discovery-flood`): size, form, age, duplicates.
            claim = read_claim(data, now)
            if (claim.announcement.instance, claim.announcement.seq, source.link) in self._seen:
                return None
            # 2. Only then signatures, within a budget: of the chain, of the announcement.
            identity = self._identity(claim, source, now, clock)
            announcement = claim.verify(identity)
            self._budget.note_verified(source)
            self._seen[announcement.instance, announcement.seq, source.link] = None
            key = identity.thumbprint
            # 3. A recorded one points to where the master was: sequence numbers only rise, and a new instance
            # is later than the previous one.
            newest = self._newest.get(key)
            if newest is not None:
                same = newest.instance == announcement.instance
                older = announcement.seq < newest.seq if same else announcement.issued < newest.issued
                if older:
                    raise AnnouncementRefused("an announcement older than one received before")
            self._newest[key] = announcement
            return self._take(identity, source, announcement, now, clock)
        except AnnouncementRefused as error:
            why = str(error)
            full = len(self.refused) >= _MAX_REASONS  # reasons quote untrusted certificates
            self.refused[_OTHER if full and why not in self.refused else why] += 1
            raise

    def probed(self, candidate: Candidate, endpoint: tuple[str, int], seconds: float) -> None:
        if candidate.rtt is None or seconds < candidate.rtt:
            candidate.rtt, candidate.endpoint = seconds, endpoint

    def ranked(self, now: int, clock: float) -> list[Candidate]:
        self._forget(now)
        return sorted(self._candidates.values(), key=lambda one: one.quality(clock))

    def best(self, now: int, clock: float) -> Candidate | None:
        return next((one for one in self.ranked(now, clock) if one.rtt is not None), None)

    def _identity(self, claim: MasterClaim, source: DatagramSource, now: int, clock: float) -> Identity:
        identity = self._chains.get(claim.chain, clock)
        if identity is not None:
            self._budget.spend(source, 1, clock, known_chain=True)
            return identity
        self._budget.spend(source, 1 + len(claim.chain), clock, known_chain=False)
        identity = claim.verify_chain(self._anchor, self._revoked, now)
        # For a minute: one that ends or is revoked meanwhile gives an address, and the handshake refuses it.
        self._chains.put(claim.chain, identity, clock)
        return identity

    def _take(
        self, identity: Identity, source: DatagramSource, announcement: Announcement, now: int, clock: float
    ) -> Candidate:
        self._forget(now)
        key = identity.thumbprint
        found = self._candidates.get((key, source))
        if found is None and len(self._candidates) >= MAX_CANDIDATES:
            raise AnnouncementRefused("more masters announce themselves than the limit allows")
        if found is None or found.announcement.instance != announcement.instance:
            found = self._candidates[key, source] = Candidate(key, identity.name, source, announcement)
        found.announcement = announcement
        found.heard.append((announcement.seq, clock))
        return found

    def _forget(self, now: int) -> None:
        self._candidates = {key: one for key, one in self._candidates.items() if now <= one.ends}

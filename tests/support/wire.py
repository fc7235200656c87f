"""Helpers for channel tests: nodes with fake certificates, connections over an in-memory wire.

A fake certificate is the name and the public key, unsigned: the channel takes any `verify`, and
real certificates have their own tests. Randomness is a counter, so runs are deterministic.
"""

import hashlib
from collections.abc import Callable
from dataclasses import dataclass, field

from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.serialization import Encoding, PublicFormat

from ca.errors import CAError
from ca.keys.signing import KeySigner
from rossec.channel.connection import Connection
from rossec.channel.edhoc.credentials import Credentials, KnownCertificates, PeerT, Renews, SelfConnections
from rossec.channel.edhoc.handshake import EdhocConfig
from rossec.channel.negotiation import Authenticated, Event, UnitReceived
from rossec.channel.opening import WireProtocol
from rossec.channel.records import Bytes, ChannelLimits
from rossec.errors import ChannelError

NOW = 1_800_000_000
DAY = 86400
NOT_AFTER = NOW + 30 * DAY


def receive(core: Connection[PeerT], data: Bytes, now: int) -> list[Event[PeerT]]:
    """Give bytes from the peer to a connection, as the reader of a socket does."""
    events: list[Event[PeerT]] = []
    rest = memoryview(data)
    while len(rest) > 0:
        room = core.get_buffer()
        count = min(len(room), len(rest))
        room[:count] = rest[:count]
        rest = rest[count:]
        events += core.buffer_updated(count, now)
    return events


@dataclass(frozen=True)
class FakeIdentity:
    name: str
    public_key: ec.EllipticCurvePublicKey
    certificate: bytes
    not_after: int = NOT_AFTER


def node(name: str) -> Credentials:
    """A node's credentials; the same key for the same name."""
    scalar = int.from_bytes(hashlib.sha256(name.encode()).digest()[:31]) + 1
    key = ec.derive_private_key(scalar, ec.SECP256R1())
    point = key.public_key().public_bytes(Encoding.X962, PublicFormat.UncompressedPoint)
    return Credentials(KeySigner(key), (point + name.encode(),))


def trust(chain: tuple[bytes, ...], now: int) -> FakeIdentity:
    """The fake `verify`: any well-formed fake certificate but that of `/stranger`."""
    certificate = chain[0]
    try:
        key = ec.EllipticCurvePublicKey.from_encoded_point(ec.SECP256R1(), certificate[:65])
        name, _, times = certificate[65:].decode().partition("#")
    except ValueError:
        raise CAError("not a certificate") from None
    if name == "/stranger":
        raise CAError("not signed by this site's authority", "enroll the node")
    return FakeIdentity(name, key, certificate, NOT_AFTER + DAY * int(times or 0))


def renewed(credentials: Credentials, times: int = 1) -> tuple[bytes, ...]:
    """The chain of a node after its certificate was renewed so many times."""
    return (credentials.chain[0] + b"#%d" % times,)


def renews(new: FakeIdentity, old: FakeIdentity) -> bool:
    """As `Identity.renews`."""
    return (new.name, new.public_key) == (old.name, old.public_key)


def dice(seed: str) -> Callable[[int], bytes]:
    """Deterministic randomness."""
    count = 0

    def random(length: int) -> bytes:
        nonlocal count
        count += 1
        return hashlib.shake_256(f"{seed}{count}".encode()).digest(length)

    return random


ALICE, BOB, STRANGER = node("/alice"), node("/bob"), node("/stranger")
DEFAULTS = ChannelLimits()
SMALL = ChannelLimits(records=4, octets=1 << 20, seconds=100, unit=1 << 20)


def alice(
    opening: WireProtocol = WireProtocol.TCPROS,
    credentials: Credentials = ALICE,
    limits: ChannelLimits = DEFAULTS,
    suites: tuple[int, ...] = (6,),
    known: KnownCertificates | None = None,
    request_x5t: bool = False,
    self_connections: SelfConnections | None = None,
    renews: Renews[FakeIdentity] | None = None,
) -> Connection[FakeIdentity]:
    """An initiator."""
    config = EdhocConfig(
        credentials,
        trust,
        dice("alice"),
        suites,
        known=known,
        request_x5t=request_x5t,
        self_connections=self_connections,
        renews=renews,
    )
    return Connection[FakeIdentity].initiator(config, now=NOW, opening=opening, limits=limits)


def bob(
    credentials: Credentials = BOB,
    limits: ChannelLimits = DEFAULTS,
    suites: tuple[int, ...] = (6,),
    accept: frozenset[WireProtocol] = frozenset(WireProtocol),
    known: KnownCertificates | None = None,
    self_connections: SelfConnections | None = None,
    renews: Renews[FakeIdentity] | None = None,
) -> Connection[FakeIdentity]:
    """A responder."""
    config = EdhocConfig(
        credentials, trust, dice("bob"), suites, known=known, self_connections=self_connections, renews=renews
    )
    return Connection[FakeIdentity].responder(config, now=NOW, limits=limits, accept=accept)


@dataclass
class End:
    """One end of a wire, and its results."""

    core: Connection[FakeIdentity]
    events: list[Event[FakeIdentity]] = field(default_factory=list)
    error: ChannelError | None = None
    sent: list[bytes] = field(default_factory=list)

    @property
    def units(self) -> list[bytes]:
        """The units delivered so far."""
        return [event.data for event in self.events if isinstance(event, UnitReceived)]

    def take(self) -> bytes:
        """The bytes this end sends."""
        data = bytes(self.core.data_to_send())
        if data:
            self.sent.append(data)
        return data

    def give(self, data: bytes, step: int = 0) -> None:
        """Feed bytes, whole or in steps; store an error instead of raising it."""
        size = step or max(1, len(data))
        try:
            for start in range(0, len(data), size):
                self.events += receive(self.core, data[start : start + size], NOW)
        except ChannelError as error:
            self.error = self.error or error


@dataclass
class Wire:
    """Two ends; `pump` transfers bytes until neither sends.

    `meddle(sender, flight)` may change a flight; flights are numbered by `sent` of the sender.
    """

    left: End
    right: End
    step: int = 0
    meddle: Callable[[End, bytes], bytes] = lambda end, data: data

    def pump(self) -> "Wire":
        """Transfer bytes both ways until none are left."""
        moved = True
        while moved:
            moved = False
            for sender, receiver in ((self.left, self.right), (self.right, self.left)):
                data = sender.take()
                if data:
                    moved = True
                    receiver.give(self.meddle(sender, data), self.step)
        return self


def wire(
    left: Connection[FakeIdentity] | None = None,
    right: Connection[FakeIdentity] | None = None,
    **options: object,
) -> Wire:
    """An unpumped wire between an initiator and a responder."""
    made = Wire(End(left or alice()), End(right or bob()))
    for name, value in options.items():
        setattr(made, name, value)
    return made


def joined(**options: object) -> Wire:
    """A wire after its handshake."""
    return wire(**options).pump()  # type: ignore[arg-type]  # options go through to `wire`


def peers(end: End) -> list[str]:
    """The names of the peers this end authenticated."""
    return [event.identity.name for event in end.events if isinstance(event, Authenticated)]

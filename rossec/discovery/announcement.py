"""The announcement of a master on the local link: one signed datagram.

Pure. The datagram carries the certificate chain that verifies it, so that a new node needs only its
trust anchor to verify it. It gives the address of the master, nothing more: the peer there still
has to authenticate in the handshake. A closed map, as every signed statement here.
"""

from dataclasses import dataclass
from typing import Final

from ca.certificates import Identity, TrustAnchor
from ca.cose import Profile
from ca.encoding import Value
from ca.errors import CAError
from ca.keys.signer import Signer
from ca.names import is_master_name
from rossec.errors import AnnouncementRefused
from rossec.ros.text import printable

PROFILE: Final = Profile("rossec-announcement+cwt")
MAX_SIZE: Final = 1232  # IPv6's smallest MTU, less its own and UDP's header (RFC 8200 section 5)
MAX_AGE: Final = 15
SKEW: Final = 5
INSTANCE_SIZE: Final = 8
_MAX_HOST: Final = 255
_MAX_CHAIN: Final = 2
_VERSION_LIMIT: Final = 1 << 31  # as XML-RPC's integers
_IAT, _MAX_AGE, _HOST, _PORT, _INSTANCE, _SEQ, _VERSION, _CHAIN = (
    6,
    -70005,
    -70011,
    -70012,
    -70013,
    -70014,
    -70015,
    33,
)


@dataclass(frozen=True)
class Announcement:
    """Where a master listens.

    Attributes:
        host: its name or address, as for ROS clients.
        port: its TCP port.
        instance: 8 random bytes, new at every start.
        seq: counts the announcements of one instance.
        issued, max_age: seconds; it is valid until `issued + max_age`.
        version: of its graph, a hint to ask it now; None: it does not say, as masters before
            rossec knew several of them, whose nodes refuse an announcement that has one.
    """

    host: str
    port: int
    instance: bytes
    seq: int
    issued: int
    max_age: int = MAX_AGE
    version: int | None = None


def sign(signer: Signer, chain: tuple[bytes, ...], announcement: Announcement) -> bytes:
    """The datagram, signed with the master's key.

    Raises:
        AnnouncementRefused: what `read_claim` would refuse, or more than one datagram.
    """
    _check(announcement)
    certificates: list[Value] = [*chain]
    version: dict[int | str, Value] = (
        {} if announcement.version is None else {_VERSION: announcement.version}
    )
    data = PROFILE.sign(
        signer,
        {
            **version,
            _IAT: announcement.issued,
            _MAX_AGE: announcement.max_age,
            _HOST: announcement.host,
            _PORT: announcement.port,
            _INSTANCE: announcement.instance,
            _SEQ: announcement.seq,
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
class Claim:
    """A datagram that is well-formed and current; nothing in it is verified yet."""

    data: bytes
    announcement: Announcement
    chain: tuple[bytes, ...]

    def verify_chain(self, anchor: TrustAnchor, revoked: frozenset[bytes], now: int) -> Identity:
        """The identity it claims: a master that the authority certified.

        Raises:
            AnnouncementRefused: not the master of this trust domain, or revoked.
        """
        try:
            identity = anchor.verify(self.chain, now)
        except CAError as error:
            raise _foreign(error) from error
        if identity.is_foreign or not is_master_name(identity.name):
            raise AnnouncementRefused(f"{identity.name} announces itself as a master")
        if not revoked.isdisjoint(identity.keys):
            raise AnnouncementRefused("the master that announces itself is revoked")
        return identity

    def verify(self, identity: Identity) -> Announcement:
        """The announcement, verified with the key of the master `identity`.

        Raises:
            AnnouncementRefused: it did not sign this.
        """
        try:
            PROFILE.open_body(self.data, identity.public_key, limit=MAX_SIZE)
        except CAError as error:
            raise _foreign(error) from error
        return self.announcement


def read_claim(data: bytes, now: int) -> Claim:
    """Check size, form and age of an untrusted datagram; no signature is verified.

    Raises:
        AnnouncementRefused: not an announcement, or not current.
    """
    try:
        announcement, chain = _read(PROFILE.peek(data, limit=MAX_SIZE))
    except CAError as error:
        raise _foreign(error) from error
    if announcement.issued > now + SKEW or announcement.issued + announcement.max_age < now:
        raise AnnouncementRefused("an announcement of another time", "check both clocks")
    return Claim(data, announcement, tuple(chain))


def _foreign(error: CAError) -> AnnouncementRefused:
    return AnnouncementRefused(f"no announcement of this domain's master: {error}")


def _read(payload: Value) -> tuple[Announcement, list[bytes]]:
    match payload:
        case {
            6: int() as issued, -70005: int() as max_age, -70011: str() as host,
            -70012: int() as port, -70013: bytes() as instance, -70014: int() as seq,
            33: list() as items, **rest,
        } if rest.keys() <= {_VERSION}:  # fmt: skip
            version = rest.get(_VERSION)
            if version is not None and not isinstance(version, int):
                raise AnnouncementRefused("the announcement's version is no number")
            announcement = Announcement(host, port, instance, seq, issued, max_age, version)
        case _:
            raise AnnouncementRefused("the announcement has missing or unknown fields")
    _check(announcement)
    chain = [item for item in items if isinstance(item, bytes)]
    if not 1 <= len(items) <= _MAX_CHAIN or len(chain) != len(items):
        raise AnnouncementRefused("the announcement carries no certificate chain")
    return announcement, chain


def _check(announcement: Announcement) -> None:
    version = 0 if announcement.version is None else announcement.version
    numbers = (
        version,
        announcement.port,
        announcement.seq,
        announcement.issued,
        announcement.max_age,
    )
    if any(isinstance(number, bool) or number < 0 for number in numbers):
        raise AnnouncementRefused("a number in the announcement is out of range")
    if not 0 < announcement.port < 1 << 16 or not 1 <= announcement.max_age <= MAX_AGE:
        raise AnnouncementRefused("the announcement's port or age is out of range")
    if version >= _VERSION_LIMIT:
        raise AnnouncementRefused("the announcement's version is out of range")
    if len(announcement.instance) != INSTANCE_SIZE:
        raise AnnouncementRefused(f"the announcement's instance has not {INSTANCE_SIZE} bytes")
    host = announcement.host
    if not 0 < len(host) <= _MAX_HOST or printable(host) != host or any(c in host for c in " /@"):
        raise AnnouncementRefused("the announcement's host is not a name or address")

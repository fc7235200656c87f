"""What the hooks of one process share: who it is, its connections, its guardian.

Until the node has a name there is no identity, and nothing can be connected: every hook that needs
one says so. Whoever asks before `rospy.init_node` begins with the name it will have, if that is
known.
"""

import errno
from collections.abc import Callable
from threading import RLock
from typing import Final

from ca.certificates import Identity
from rossec import clock
from rossec.errors import ChannelError, ConfigurationError, PlainPeer
from rossec.inprocess.allow_plain import PlainPeers
from rossec.inprocess.background import BackgroundLoop
from rossec.inprocess.connector import Connector
from rossec.inprocess.identity import LocalIdentity
from rossec.inprocess.live_connections import LiveConnection, LiveConnections
from rossec.inprocess.registrations import Registrations
from rossec.inprocess.reporting import Reporter
from rossec.inprocess.sockets import RosSocket
from rossec.participant.own_addresses import OwnAddresses
from rossec.participant.revocation_watch import CLOCK_SET_BACK

_NAMELESS: Final = (
    "call rospy.init_node first, or give the name it will have:"
    " rossec.secure('name'), or __name:=name on the command line"
)


class SecuredProcess:
    """One secured process."""

    def __init__(self, reporter: Reporter, plain: PlainPeers = PlainPeers()) -> None:  # noqa: B008 - constant
        self.reporter = reporter
        self.plain = plain
        self.links = LiveConnections()
        self._setbacks = clock.Setbacks()
        self.own = OwnAddresses()
        self.rights = 0
        """Grows whenever there is a new grant or list: what was refused may be tried again."""
        self._begun: tuple[LocalIdentity, Connector, Registrations, BackgroundLoop] | None = None
        self._beginning = RLock()
        self.introduce: Callable[[], None] = lambda: None
        """Begins, if the name that the node will have is known."""

    def begin(self, member: LocalIdentity, master: tuple[str, int]) -> None:
        """Speak as `member` from now on, with the master there."""
        doors, registrations = (
            Connector(member, own=self.own),
            Registrations(member.name, clock.counter()),
        )
        guardian = BackgroundLoop(self, member, registrations, master)
        self._begun = member, doors, registrations, guardian
        guardian.start()

    @property
    def has_begun(self) -> bool:
        """Whether the node has a name and an identity."""
        return self._begun is not None

    def _all(self) -> tuple[LocalIdentity, Connector, Registrations, BackgroundLoop]:
        if self._begun is None:
            with self._beginning:
                if self._begun is None:
                    self.introduce()
        if self._begun is None:
            raise _shown(ConfigurationError("this program has no name yet", _NAMELESS))
        return self._begun

    def require_name(self) -> None:
        """Return once the node has begun; raises `ConfigurationError` while it has no name."""
        self._all()

    @property
    def member(self) -> LocalIdentity:
        """The node. Raises `ConfigurationError` while it has no name; so do the other three."""
        return self._all()[0]

    @property
    def doors(self) -> Connector:
        """Makes its connections."""
        return self._all()[1]

    @property
    def registrations(self) -> Registrations:
        """What it registered."""
        return self._all()[2]

    @property
    def guardian(self) -> BackgroundLoop:
        """Its standing with the master."""
        return self._all()[3]

    # -- connections

    def listens(self, port: int, host: str | None = None) -> None:
        """This node accepts callers there; rospy tells every one of them the same host."""
        self.own.add_ports(self.own.host if host is None else host, port)

    def watch(self, sock: RosSocket, link: LiveConnection) -> None:
        """An admitted connection: end it when its right does."""
        sock.link = link
        self.links.add(link, sock.abort)

    def gone(self, sock: RosSocket) -> None:
        """A connection is over."""
        self.links.forget(sock)
        if isinstance(sock.link, LiveConnection):
            self.links.discard(sock.link)

    def may_be_plain(self, name: str, address: str) -> bool:
        """Whether `allow_plain` names this; if so it is said, loudly."""
        allowed = self.plain.allows(name, address)
        if allowed:
            self.reporter.warn(f"PLAIN: {name} with {address}, neither encrypted nor checked")
        return allowed

    def failed(self, address: tuple[str, int], error: ChannelError) -> Exception:
        """Tell the developer; what rospy is to be told."""
        self.reporter.warn(f"cannot connect to {address[0]} port {address[1]}", error)
        if isinstance(error, PlainPeer):  # it will not change
            return ConnectionError(f"rossec: {error}")
        return ConnectionAbortedError(errno.ECONNABORTED, f"rossec: {error}")  # rospy tries again

    # -- what the guardian tells

    def take_revocations(self, data: bytes, timestamp: bytes, master: Identity) -> None:
        """Take over a list and its confirmation, then cut what they end.

        Raises:
            CAError: either does not hold. What the list revokes is cut nevertheless.
        """
        before = self.member.revocations.data
        try:
            self.member.take_revocations(data, timestamp, master)
        finally:
            self.cut()
            if self.member.revocations.data != before:
                self.rights += 1

    def cut(self) -> None:
        """End every connection whose right has ended."""
        member = self.member
        if self._setbacks.any_new():
            self.reporter.warn(CLOCK_SET_BACK)
            member.doubt()
        for link, reason in self.links.must_end(member.termination_reason):
            self.reporter.warn(f"cut {link.stream.peer.name} ({link.decision.name}): {reason}")
        self.links.cut_peers(member.is_revoked)

    def run_timers(self) -> None:
        """Keep the keys of idle connections renewed: rospy reads and writes only what it needs."""
        for stream in self.links.streams():
            if isinstance(stream, RosSocket):
                stream.run_timers()


def _shown(error: ConfigurationError) -> ConfigurationError:
    """With its hint in a traceback: this one is for whoever wrote the program."""
    error.add_note(f"hint: {error.hint}")
    return error

"""What the hooks of one process share: its identity, connections and background loop.

Until the node has a name there is no identity, and no connection can be made: every hook that needs
one raises. A call before `rospy.init_node` uses the name the node will have, if that is known.
"""

import errno
from collections.abc import Callable
from threading import RLock
from typing import Final, TypeAlias

from grants.guard import Guard
from rossec import clock
from rossec.errors import ChannelError, ConfigurationError, PlainPeer
from rossec.inprocess.allow_plain import PlainPeers
from rossec.inprocess.background import BackgroundLoop
from rossec.inprocess.connector import Connector
from rossec.inprocess.identity import LocalIdentity
from rossec.inprocess.registrations import Registrations
from rossec.inprocess.reporting import Reporter
from rossec.inprocess.sockets import RosSocket
from rossec.participant.authorized import AuthorizedConnection
from rossec.participant.connections import ConnectionTable
from rossec.participant.membership import Membership
from rossec.participant.own_addresses import OwnAddresses

RosConnection: TypeAlias = AuthorizedConnection[RosSocket, Guard | None]
_NAMELESS: Final = (
    "call rospy.init_node first, or give the name it will have:"
    " rossec.secure('name'), or __name:=name on the command line"
)


class SecuredProcess:
    """One secured process."""

    def __init__(self, reporter: Reporter, plain: PlainPeers = PlainPeers()) -> None:  # noqa: B008 - constant
        self.reporter = reporter
        self.plain = plain
        self.own_addresses = OwnAddresses()
        self._begun: tuple[LocalIdentity, Connector, Registrations, BackgroundLoop] | None = None
        self._begin_lock = RLock()
        self.begin_early: Callable[[], None] = lambda: None
        """Calls `begin` if the name that the node will have is known."""

    def begin(self, local_identity: LocalIdentity, master: tuple[str, int]) -> None:
        """Use `local_identity` and the master at that address from now on."""
        connector, registrations = (
            Connector(local_identity, self.own_addresses),
            Registrations(clock.counter()),
        )
        background_loop = BackgroundLoop(local_identity, registrations, master)
        self._begun = local_identity, connector, registrations, background_loop
        background_loop.start()

    @property
    def has_begun(self) -> bool:
        """Whether the node has a name and an identity."""
        return self._begun is not None

    def _require_begun(self) -> tuple[LocalIdentity, Connector, Registrations, BackgroundLoop]:
        if self._begun is None:
            with self._begin_lock:
                if self._begun is None:
                    self.begin_early()
        if self._begun is None:
            raise _with_hint(ConfigurationError("this program has no name yet", _NAMELESS))
        return self._begun

    def require_name(self) -> None:
        """Return once the node has begun; raises `ConfigurationError` while it has no name."""
        self._require_begun()

    @property
    def local_identity(self) -> LocalIdentity:
        """The node. Raises `ConfigurationError` while it has no name; so do the next five."""
        return self._require_begun()[0]

    @property
    def connector(self) -> Connector:
        """Makes the connections of this process."""
        return self._require_begun()[1]

    @property
    def registrations(self) -> Registrations:
        """What this node registered with the master."""
        return self._require_begun()[2]

    @property
    def background_loop(self) -> BackgroundLoop:
        """Holds the session with the master."""
        return self._require_begun()[3]

    @property
    def membership(self) -> Membership:
        """Keeps grants, identity and revocation data current."""
        return self.background_loop.membership

    @property
    def connections(self) -> ConnectionTable[RosSocket]:
        """The connections of this process."""
        return self.background_loop.connections

    # -- connections

    def listens(self, port: int, host: str | None = None) -> None:
        """This node accepts callers there; rospy announces the same host for all its ports."""
        self.own_addresses.add_ports(self.own_addresses.host if host is None else host, port)

    def add_connection(self, sock: RosSocket, connection: RosConnection) -> None:
        """Add an admitted connection: it is cut when its right ends; raises as the table."""
        sock.connection = connection
        self.connections.add(connection)

    def follows(self, sock: RosSocket, topic: str, publisher: str) -> None:
        """An admitted connection to a publisher, by its URI: it is left as the master says."""
        self.background_loop.followed.add(sock, topic, publisher)

    def connection_closed(self, sock: RosSocket) -> None:
        """A connection is closed."""
        if self.has_begun:
            self.connections.forget(sock)
            self.background_loop.followed.discard(sock)
        if isinstance(sock.connection, AuthorizedConnection):
            self.connections.discard(sock.connection)

    def allows_plain(self, name: str, address: str) -> bool:
        """Whether `allow_plain` names this; if so, a warning is logged."""
        allowed = self.plain.allows(name, address)
        if allowed:
            self.reporter.warn(f"PLAIN: {name} with {address}, neither encrypted nor checked")
        return allowed

    def connect_error(self, address: tuple[str, int], error: ChannelError) -> Exception:
        """Log that a connection failed; returns the exception for rospy."""
        self.reporter.warn(f"cannot connect to {address[0]} port {address[1]}", error)
        if isinstance(error, PlainPeer):  # rospy does not try again
            return ConnectionError(f"rossec: {error}")
        return ConnectionAbortedError(errno.ECONNABORTED, f"rossec: {error}")  # rospy tries again


def _with_hint(error: ConfigurationError) -> ConfigurationError:
    """With the hint in the traceback, which the programmer sees."""
    error.add_note(f"hint: {error.hint}")
    return error

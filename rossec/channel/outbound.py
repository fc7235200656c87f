"""The half of a connection that sends: units to records, the close, renewal and deadlines.

`Connection` adds the half that receives. What is sealed must be written in order and at once, for
its counter is used: records queued meanwhile go first.
"""

from collections.abc import Iterator, Sequence
from typing import Final, Generic, Protocol

from rossec.channel.buffers import SMALL, ReceiveBuffer
from rossec.channel.edhoc.credentials import PeerT
from rossec.channel.negotiation import Negotiation, Preamble
from rossec.channel.opening import WireProtocol
from rossec.channel.records import MAX_GRANTS, Bytes, ChannelLimits, Frame
from rossec.channel.renewals import Renewals
from rossec.channel.session import Session
from rossec.channel.states import ENDED, SENDING, ConnectionState, Event
from rossec.errors import (
    ChannelClosed,
    ChannelError,
    HandshakeTimeout,
    IdentityExpired,
    LimitExceeded,
    ProtocolViolation,
)

_ONE_RECORD: Final = 64 * 1024
HINT_SILENT: Final = "it may be a plain ROS node, which has no identity, or overloaded"


class OpenStreams(Protocol):
    """Keeps the open connections of an identity, to present its renewed certificate on them."""

    def add(self, stream: "PresentsIdentity") -> None:
        """A connection has begun."""


class PresentsIdentity(Protocol):
    """What moves the bytes of a connection."""

    def present_identity(self, chain: Sequence[bytes]) -> None:
        """As `Outbound.present_identity`, from any thread, without waiting."""


class Outbound(Generic[PeerT]):
    """The state of a connection, and everything that does not depend on what arrives.

    Attributes:
        streams: where what moves its bytes belongs, if its certificate may be renewed.
    """

    def __init__(
        self,
        preamble: Preamble,
        negotiation: Negotiation[PeerT],
        now: int,
        limits: ChannelLimits,
        buffer: int = SMALL,
    ) -> None:
        self._preamble = preamble
        self._negotiation = negotiation
        self._limits = limits
        self._now = now
        self._handshake_deadline = now + limits.handshake_seconds
        self._buffer = ReceiveBuffer(buffer)
        self._out: list[Bytes] = []
        self._events: list[Event[PeerT]] = []
        self._peer: PeerT | None = None
        self._session: Session | None = None
        self._sealing = False
        self._renewals: Renewals[PeerT] | None = None
        self._own_chain: Sequence[bytes] = ()
        self.streams: OpenStreams | None = None
        self.state = ConnectionState.OPENING

    @property
    def protocol(self) -> WireProtocol:
        """The protocol in which the connection opened."""
        return self._preamble.protocol

    @property
    def unit_limit(self) -> int:
        """How long a unit may be."""
        return self._limits.unit

    @property
    def has_unfinished_unit(self) -> bool:
        """Whether a unit is incomplete: `deadline` says when to check its progress."""
        return self._session is not None and self._session.deadline is not None

    def raise_unit_limit(self, limit: int | None = None) -> None:
        """Accept units of up to `limit`, or `ChannelLimits.unit`: the peer is authorized.

        Raises:
            ChannelClosed: there is no open connection.
        """
        self._open_session().raise_unit_limit(limit)

    def pad_units(self, multiple: int) -> None:
        """Pad what is sent from now on to a multiple of so many bytes; 0: do not."""
        if self._session is not None:  # else nothing is sent any more
            self._session.pad = multiple

    def _open_session(self) -> Session:
        if self._session is None:
            raise ChannelClosed("the connection is closed")
        return self._session

    # -- sending

    def seal_unit(self, *pieces: Bytes, reuse: bool = False) -> Iterator[Bytes]:
        """Yield what to send for a unit, record by record; write each before taking the next.

        With `reuse` a record holds until the next is taken: write it, or copy it, before that.
        A unit that has begun must be finished: if that is not possible, drop the connection.

        Raises:
            LimitExceeded: too long, at once, and nothing has happened.
            ChannelClosed: there is no open connection (any more).
            ProtocolViolation: a unit begun before is not finished.
        """
        self.check_unit(pieces)
        return self._sealed(pieces, reuse=reuse)

    def check_unit(self, pieces: Sequence[Bytes]) -> None:
        """Refuse a unit that `seal_unit` would refuse; nothing has happened to the connection.

        Raises:
            LimitExceeded, ChannelClosed: as for `seal_unit`.
        """
        self._sendable().check_unit(pieces)

    def seal_small(self, unit: Bytes) -> Bytes | None:
        """Seal a unit in one record: the fast path.

        None: it does not apply, use `seal_unit`.
        """
        small = 0 < len(unit) <= min(_ONE_RECORD, self._limits.unit)
        if (
            self._out
            or self._sealing
            or not small
            or self.state not in SENDING
            or self._session is None
        ):
            return None
        return self._session.seal_small(unit)

    def _sealed(self, pieces: Sequence[Bytes], *, reuse: bool) -> Iterator[Bytes]:
        if self._sealing:
            raise ProtocolViolation("a second unit in the middle of the first")
        self._sealing = True
        try:
            for record in self._sendable().seal_unit(pieces, reuse=reuse):
                # A record sealed meanwhile has the smaller counter: it goes first.
                yield b"".join((self.data_to_send(), record)) if self._out else record
                self._sendable()
            self._sealing = False  # it stays set when a unit is abandoned
        except LimitExceeded:
            self._terminate()
            raise

    def _sendable(self) -> Session:
        if self.state not in SENDING:
            raise ChannelClosed("the connection is closed")
        return self._open_session()

    def send_unit(self, *pieces: Bytes) -> None:
        """Seal a unit and queue it for `data_to_send`; an empty one sends nothing.

        Raises:
            LimitExceeded, ChannelClosed: as for `seal_unit`.
        """
        records = list(self.seal_unit(*pieces))  # takes what was queued before
        self._out += records

    # -- what is renewed

    @property
    def takes_renewals(self) -> bool:
        """Whether both sides take renewed certificates and grants."""
        return self._renewals is not None and self.state is ConnectionState.OPEN

    @property
    def _carries_grants(self) -> bool:
        return self.protocol is WireProtocol.TCPROS

    def present_identity(self, chain: Sequence[bytes]) -> None:
        """Queue this side's certificates, unless the peer has them; before the end of the handshake
        they are queued then. Nothing for a peer that takes none."""
        self._own_chain = chain
        renewals = self._renewals
        if chain and renewals is not None and self.takes_renewals:
            data = renewals.own(chain)
            if data is not None:
                self._out.append(self._open_session().seal_renewal(Frame.IDENTITY, data))

    def present_grants(self, data: bytes) -> bool:
        """Queue grants that take the place of those presented before; false: the peer takes none.

        On a connection for calls they are presented by a call.

        Raises:
            LimitExceeded: they are too long; nothing has happened.
        """
        if not (self.takes_renewals and self._carries_grants):
            return False
        if not 0 < len(data) <= MAX_GRANTS:
            raise LimitExceeded(f"{len(data)} bytes of grants, where 1 to {MAX_GRANTS} are allowed")
        self._out.append(self._open_session().seal_renewal(Frame.GRANTS, data))
        return True

    @property
    def has_data_to_send(self) -> bool:
        """Whether `data_to_send` has something to return."""
        return any(self._out)

    @property
    def awaits_peer(self) -> bool:
        """Whether the peer has yet to follow a renewal of the keys."""
        return self._session is not None and self._session.awaits_peer

    def data_to_send(self) -> Bytes:
        """Return, once, everything queued for the peer."""
        if not self._out:
            return b""
        out, self._out = self._out, []
        return out[0] if len(out) == 1 else b"".join(out)

    def put_back(self, rest: Bytes) -> None:
        """Put what could not be written yet in front of the queue."""
        if rest:
            self._out.insert(0, rest)

    def close(self) -> None:
        """Queue the authenticated close; what the peer still sends is discarded."""
        if self.state in SENDING:
            self._out.append(self._sendable().close_record())
            self._session = None
            self.state = ConnectionState.CLOSING
        elif self.state is not ConnectionState.CLOSING:
            self.state = ConnectionState.CLOSED

    def abandon(self) -> None:
        """Forget keys and counters at once; nothing is sent (a forked process must not)."""
        self._terminate()

    # -- time and ends

    def deadline(self) -> int | None:
        """When `tick` has to be called at the latest."""
        if self.state in ENDED:
            return None
        if self.state is not ConnectionState.OPEN or self._session is None or self._peer is None:
            return self._handshake_deadline
        unit = self._session.deadline
        last = min(self._session.renew_at, self._peer.not_after)
        return last if unit is None else min(last, unit)

    def tick(self, now: int, *, reading: bool = True) -> None:
        """Handle timeouts: renew keys, or end a connection whose time is over.

        While the shell is not `reading`, the peer cannot complete a unit: no time-out for it.

        Raises:
            HandshakeTimeout, IdentityExpired, LimitExceeded: the connection has ended.
        """
        self._now = now
        deadline = self.deadline()
        if deadline is None or now < deadline:
            return
        try:
            self._handle_timeout(now, reading=reading)
        except ChannelError:
            self._terminate()
            raise

    def _handle_timeout(self, now: int, *, reading: bool) -> None:
        if self.state is not ConnectionState.OPEN or self._session is None or self._peer is None:
            raise HandshakeTimeout(
                "the peer did not finish the handshake in time",
                HINT_SILENT,
            )
        if now >= self._peer.not_after:
            raise IdentityExpired("the peer's certificate has expired", "renew it")
        self._session.check_progress(now, reading=reading)
        self._out.append(self._session.renew(now))

    def _terminate(self) -> None:
        """End; an error, which others may keep, must not keep what was received alive."""
        self.state = ConnectionState.CLOSED
        if self._session is not None:
            self._session.discard()
        self._session = None
        self._buffer.clear()
        self._negotiation.forget()
        self._out = []

"""One secure connection without its socket: bytes and `now` in, events and bytes out.

`states.TABLE` is its life. The first flaw of any kind ends it: nothing is delivered or sent after
that, except one last flight that tells a peer which is not authenticated yet that it was refused,
in one generic text (no oracle). Verified units of the same call are dropped with the connection.
A caller writes every byte it is handed, in order and at once, or drops the connection.
"""

from collections.abc import Collection, Iterator, Sequence
from typing import Final, Generic, Self

from rossec.channel.buffers import SMALL, ReceiveBuffer
from rossec.channel.credentials import OwnCredential, PeerT, Verify
from rossec.channel.handshake import Party, Responder
from rossec.channel.messages import UNSPECIFIED, encode_error
from rossec.channel.negotiation import Negotiation, Preamble, Step
from rossec.channel.opening import Flavour
from rossec.channel.records import (
    HEADER,
    MAX_PLAINTEXT,
    TAG,
    Bytes,
    Frame,
    Limits,
    check_header,
    frame,
)
from rossec.channel.session import Session
from rossec.channel.states import (
    DEAD,
    HANDSHAKING,
    PREAMBLE,
    SENDING,
    TABLE,
    UNPROVEN,
    Authenticated,
    Closed,
    Event,
    State,
    UnitReceived,
)
from rossec.channel.suites import PRODUCTION, Random
from rossec.errors import (
    ChannelClosed,
    ChannelError,
    ConnectionTruncated,
    HandshakeFailed,
    HandshakeTimeout,
    IdentityExpired,
    LimitExceeded,
    ProtocolViolation,
)

_OPEN_BUFFER: Final = 64 * 1024
_FULL_BUFFER: Final = 2 * (HEADER + MAX_PLAINTEXT + TAG)  # two whole records stay aligned
_REFUSED: Final = frame(Frame.ERROR, encode_error(UNSPECIFIED, "handshake refused"))
_DEFAULTS: Final = Limits()
_HINT_SILENT: Final = "it may be a plain ROS node, which has no identity, or overloaded"
_BOTH: Final = frozenset(Flavour)


class Connection(Generic[PeerT]):
    """A connection of either role: make one with `initiator` or `responder`."""

    def __init__(
        self, preamble: Preamble, negotiation: Negotiation[PeerT], now: int, limits: Limits
    ) -> None:
        self._preamble = preamble
        self._negotiation = negotiation
        self._limits = limits
        self._now = now
        self._give_up_at = now + limits.handshake_seconds
        self._inbox = ReceiveBuffer(SMALL)
        self._out: list[bytes | bytearray] = []
        self._events: list[Event[PeerT]] = []
        self._peer: PeerT | None = None
        self._session: Session | None = None
        self._sealing = False
        self.state = State.OPENING

    @classmethod
    def initiator(
        cls,
        credentials: OwnCredential,
        verify: Verify[PeerT],
        *,
        random: Random,
        now: int,
        opening: Flavour = Flavour.TCPROS,
        suites: tuple[int, ...] = PRODUCTION,
        limits: Limits = _DEFAULTS,
    ) -> Self:
        """The side that connected; its first flight is ready to send."""
        negotiation, message_1 = Negotiation.begin(Party(credentials, verify, random, suites))
        preamble = Preamble(opening, None)
        connection = cls(preamble, negotiation, now, limits)
        connection._out += [preamble.take(), message_1]
        return connection

    @classmethod
    def responder(
        cls,
        credentials: OwnCredential,
        verify: Verify[PeerT],
        *,
        random: Random,
        now: int,
        accept: Collection[Flavour] = _BOTH,
        suites: tuple[int, ...] = PRODUCTION,
        limits: Limits = _DEFAULTS,
    ) -> Self:
        """The side that was connected to; `accept` says which openings may lead on."""
        party = Party(credentials, verify, random, suites)
        preamble = Preamble(Flavour.TCPROS, accept)
        return cls(preamble, Negotiation(Responder(party)), now, limits)

    @property
    def flavour(self) -> Flavour:
        """How the connection introduced itself."""
        return self._preamble.flavour

    # -- receiving

    def get_buffer(self) -> memoryview:
        """Where the next bytes from the socket go; valid until the next call of any method."""
        return self._inbox.free()

    def receive_data(self, data: Bytes, now: int) -> list[Event[PeerT]]:
        """Take bytes from the peer. `get_buffer` and `buffer_updated` save the copy.

        Raises:
            ChannelError: the connection is at its end; `data_to_send` may hold a last flight.
        """
        events: list[Event[PeerT]] = []
        rest = memoryview(data)
        while len(rest) > 0:
            room = self._inbox.free()
            count = min(len(room), len(rest))
            room[:count] = rest[:count]
            rest = rest[count:]
            events += self.buffer_updated(count, now)
        return events

    def buffer_updated(self, count: int, now: int) -> list[Event[PeerT]]:
        """Take the `count` bytes that were written into `get_buffer`.

        Raises:
            ChannelError: as for `receive_data`.
        """
        self._now = now
        self._inbox.filled(count)
        events = self._events = []
        try:
            self._run()
        except ChannelError:
            self._last_flight()
            raise
        except BaseException:
            self._die()  # a bug is a flaw like any other
            raise
        return events

    def receive_eof(self) -> None:
        """The peer ended the TCP stream.

        Raises:
            ConnectionTruncated: without its authenticated close.
            HandshakeFailed: before the handshake was done.
        """
        if self.state in DEAD:
            self.state = State.CLOSED
            return
        opened = self.state is State.OPEN
        self._die()
        if opened:
            raise ConnectionTruncated(
                "the connection ended without the peer's close",
                "data may be missing: the peer crashed, or somebody cut the connection",
            )
        raise HandshakeFailed(
            "the peer ended the connection during the handshake",
            _HINT_SILENT,
        )

    def _run(self) -> None:
        if self.state in PREAMBLE:
            self._introduce()
        inbox = self._inbox
        while self.state not in DEAD and self.state not in PREAMBLE:
            view = inbox.unread()
            if len(view) < HEADER:
                return
            head = bytes(view[:HEADER])
            row = self._row(head)
            size = HEADER + int.from_bytes(head[1:])
            if len(view) < size:
                inbox.reserve(size, _OPEN_BUFFER if size < _OPEN_BUFFER else _FULL_BUFFER)
                return
            self._take(row, head, view[HEADER:size])
            inbox.consume(size)
        if self.state in DEAD:
            inbox.consume(len(inbox))

    def _introduce(self) -> None:
        try:
            self.state = self._preamble.feed(self._inbox, self.state)
        finally:
            self._out.append(self._preamble.take())

    def _row(self, head: bytes) -> tuple[str, tuple[State, ...]]:
        row = _ROWS[self.state].get(head[0] >> 4)
        if row is None:
            raise ProtocolViolation(f"frame of type {head[0] >> 4} in state: {self.state.value}")
        check_header(head, 0 if self._session is None else self._session.receive_epoch)
        return row

    def _take(self, row: tuple[str, tuple[State, ...]], head: bytes, body: memoryview) -> None:
        name, following = row
        if self.state in HANDSHAKING:
            state = self._advance(getattr(self._negotiation, name)(bytes(body), self._now))
        else:
            state = getattr(self, name)(head, body)
        assert state in following  # noqa: S101 - the table is the truth, and tests run with it
        self.state = state

    def _advance(self, step: Step[PeerT]) -> State:
        if step.peer is not None:
            self._peer = step.peer
            self._session = self._negotiation.session(self._limits, self._now)
            self._events.append(Authenticated(step.peer))
        self._out.append(step.reply)
        return step.state

    # -- records: the rows of the table for an open connection

    def _open_session(self) -> Session:
        if self._session is None:
            raise ChannelClosed("the connection is closed")
        return self._session

    def _on_data(self, head: bytes, body: memoryview) -> State:
        self._open_session().data(head, body)
        return State.OPEN

    def _on_data_end(self, head: bytes, body: memoryview) -> State:
        self._events.append(UnitReceived(self._open_session().data_end(head, body)))
        return State.OPEN

    def _on_rekey(self, head: bytes, body: memoryview) -> State:
        self._out.append(self._open_session().rekey(head, body))
        return State.OPEN

    def _on_close(self, head: bytes, body: memoryview) -> State:
        session = self._open_session()
        session.close(head, body)
        self._out.append(session.close_record())
        self._session = None
        self._events.append(Closed())
        return State.CLOSED

    # -- sending

    def seal_unit(self, *pieces: Bytes) -> Iterator[bytes | bytearray]:
        """Yield what to send for a unit, record by record; write each before taking the next.

        A unit that has begun must be finished: if that is not possible, drop the connection.

        Raises:
            LimitExceeded: too long, at once, and nothing has happened.
            ChannelClosed: there is no open connection (any more).
            ProtocolViolation: a unit begun before is not finished.
        """
        self._sendable().check_unit(pieces)
        return self._sealed(pieces)

    def seal_small(self, unit: bytes) -> bytes | bytearray | None:
        """Seal a unit in one record: the short way, where nothing else has to be done.

        None means that something has: use `seal_unit`.
        """
        small = 0 < len(unit) <= min(_OPEN_BUFFER, self._limits.unit)
        if (
            self._out
            or self._sealing
            or not small
            or self.state not in SENDING
            or self._session is None
        ):
            return None
        return self._session.seal_small(unit)

    def _sealed(self, pieces: Sequence[Bytes]) -> Iterator[bytes | bytearray]:
        if self._sealing:
            raise ProtocolViolation("a second unit in the middle of the first")
        self._sealing = True
        try:
            for record in self._sendable().seal_unit(pieces):
                # Whatever was sealed meanwhile has the smaller counter: it goes first.
                yield self.data_to_send() + record if self._out else record
                self._sendable()
            self._sealing = False  # and stays set when a unit is given up half-way
        except LimitExceeded:
            self._die()
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

    def data_to_send(self) -> bytes | bytearray:
        """Return, once, everything queued for the peer."""
        out, self._out = self._out, []
        return out[0] if len(out) == 1 else b"".join(out)

    def close(self) -> None:
        """Queue the authenticated close; what the peer still sends is thrown away."""
        if self.state in SENDING:
            self._out.append(self._sendable().close_record())
            self._session = None
            self.state = State.CLOSING
        elif self.state is not State.CLOSING:
            self.state = State.CLOSED

    # -- time and ends

    def deadline(self) -> int | None:
        """When `tick` has to be called at the latest."""
        if self.state in DEAD:
            return None
        if self.state is not State.OPEN or self._session is None or self._peer is None:
            return self._give_up_at
        return min(self._session.renew_at, self._peer.not_after)

    def tick(self, now: int) -> None:
        """Act on the time: renew keys, or end a connection that has outlived its right.

        Raises:
            HandshakeTimeout, IdentityExpired, LimitExceeded: the connection is at its end.
        """
        self._now = now
        deadline = self.deadline()
        if deadline is None or now < deadline:
            return
        try:
            self._act(now)
        except ChannelError:
            self._die()
            raise

    def _act(self, now: int) -> None:
        if self.state is not State.OPEN or self._session is None or self._peer is None:
            raise HandshakeTimeout(
                "the peer did not finish the handshake in time",
                _HINT_SILENT,
            )
        if now >= self._peer.not_after:
            raise IdentityExpired("the peer's certificate ran out", "renew it")
        self._out.append(self._session.renew(now))

    def _last_flight(self) -> None:
        """Die; tell a peer that is still unproven, unless it told us first."""
        tell = self.state in UNPROVEN and not self._negotiation.told
        out = self._out if self.state in UNPROVEN | PREAMBLE else []
        self._die()
        self._out = [*out, _REFUSED] if tell else out

    def _die(self) -> None:
        self.state = State.CLOSED
        self._session = None
        self._negotiation.forget()
        self._out = []


_ROWS: Final = {
    state: {kind.value: row for (there, kind), row in TABLE.items() if there is state}
    for state in State
}

"""One secure connection without its socket: bytes and `now` in, events and bytes out.

`negotiation.TABLE` is its state machine. Any error ends it: nothing is delivered or sent afterwards, except
one last flight that tells a peer not authenticated yet that it was refused, in one generic text (no oracle).
Verified units of the same call are dropped with the connection. The caller writes all bytes it is given, in
order and at once, or drops the connection: what is sealed has used its counter, so records queued meanwhile
go first.
"""

from collections.abc import Collection, Iterator, Sequence
from typing import Final, Generic, Protocol, Self

from ca.errors import HintedError
from rossec import errors
from rossec.channel import negotiation
from rossec.channel.edhoc.credentials import PeerT
from rossec.channel.edhoc.handshake import EdhocConfig, Initiator, Responder
from rossec.channel.edhoc.messages import MAX_MESSAGE_1, UNKNOWN_CREDENTIAL, UNSPECIFIED, encode_error
from rossec.channel.negotiation import (
    ENDED,
    FRAMED,
    HANDSHAKING,
    PREAMBLE,
    SENDING,
    ConnectionState,
    Event,
    UnitReceived,
)
from rossec.channel.opening import WireProtocol
from rossec.channel.records import (
    HEADER,
    MAX_GRANTS,
    MAX_PLAINTEXT,
    TAG,
    Bytes,
    ChannelLimits,
    Frame,
    check_header,
    frame,
)
from rossec.channel.session import FIRST, SMALL, ReceiveBuffer, Session
from rossec.channel.tuning import ONE_RECORD

HINT_SILENT: Final = "it may be a plain ROS node, which has no identity, or overloaded"
_OPEN_BUFFER: Final = 64 * 1024
_FULL_BUFFER: Final = 2 * (HEADER + MAX_PLAINTEXT + TAG)  # two whole records stay aligned
_REFUSED: Final = frame(Frame.ERROR, encode_error(UNSPECIFIED, "handshake refused"))
_UNKNOWN: Final = frame(Frame.ERROR, encode_error(UNKNOWN_CREDENTIAL, info=True))
_DEFAULTS: Final = ChannelLimits()
_BOTH: Final = frozenset(WireProtocol)
_RENEWING: Final = frozenset((Frame.IDENTITY.value, Frame.GRANTS.value))
_ROWS: Final = {
    state: {kind.value: row for (there, kind), row in negotiation.TABLE.items() if there is state}
    for state in ConnectionState
}


class OpenStreams(Protocol):
    def add(self, stream: "PresentsIdentity") -> None: ...


class PresentsIdentity(Protocol):
    def present_identity(self, chain: Sequence[bytes]) -> None:
        """As `Outbound.present_identity`, from any thread, without waiting."""


class Connection(Generic[PeerT]):
    """A connection of either role: make one with `initiator` or `responder`. `streams`: where what moves its
    bytes belongs, if its certificate may be renewed."""

    __slots__ = (
        "__weakref__",
        "_buffer",
        "_events",
        "_handshake_deadline",
        "_limits",
        "_negotiation",
        "_now",
        "_out",
        "_own_chain",
        "_peer",
        "_preamble",
        "_renewals",
        "_sealing",
        "_session",
        "state",
        "streams",
    )

    def __init__(
        self,
        preamble: negotiation.Preamble,
        steps: negotiation.Negotiation[PeerT],
        now: int,
        limits: ChannelLimits,
        buffer: int = SMALL,
    ) -> None:
        self._preamble = preamble
        self._negotiation: negotiation.Negotiation[PeerT] | None = steps  # until the connection is open
        self._limits = limits
        self._now = now
        self._handshake_deadline = now + limits.handshake_seconds
        self._buffer = ReceiveBuffer(buffer)
        self._out: list[Bytes] = []
        self._peer: PeerT | None = None
        self._session: Session | None = None
        self._sealing = False
        self._renewals: negotiation.ConnectionRenewals[PeerT] | None = None
        self._own_chain: Sequence[bytes] = ()
        self.streams: OpenStreams | None = None
        self.state = ConnectionState.OPENING

    @classmethod
    def initiator(
        cls,
        config: EdhocConfig[PeerT],
        *,
        now: int,
        opening: WireProtocol = WireProtocol.TCPROS,
        limits: ChannelLimits = _DEFAULTS,
    ) -> Self:
        """The side that connected; its first flight is ready to send.

        With `known` certificates are cached, and `request_x5t` asks the responder to send a hash of its own:
        for an address where a known peer was reached before. `OwnCredentialUnknown` and
        `PeerCredentialUnknown` mean: forget the introductions, and retry without `request_x5t`. With
        `self_connections`, which this node's listeners share, it means to reach itself, and no other peer is
        accepted. With `renews` the peer is told that renewed certificates and grants are taken here.
        """
        edhoc, preamble = Initiator(config), negotiation.Preamble(opening, None)
        connection = cls(preamble, negotiation.Negotiation(edhoc), now, limits)
        connection._out += [preamble.take(), frame(Frame.HANDSHAKE, edhoc.make_message_1())]
        return connection

    @classmethod
    def responder(
        cls,
        config: EdhocConfig[PeerT],
        *,
        now: int,
        accept: Collection[WireProtocol] = _BOTH,
        limits: ChannelLimits = _DEFAULTS,
    ) -> Self:
        """The side that was connected to; `accept` says which openings are accepted. With
        `self_connections` this node may connect to itself, for dials noted there. `renews`: as for the
        initiator."""
        preamble = negotiation.Preamble(WireProtocol.TCPROS, accept)
        return cls(preamble, negotiation.Negotiation(Responder(config)), now, limits, FIRST)

    @property
    def protocol(self) -> WireProtocol:
        return self._preamble.protocol

    @property
    def unit_limit(self) -> int:
        return self._limits.unit

    @property
    def has_unfinished_unit(self) -> bool:
        return self._session is not None and self._session.deadline is not None

    def raise_unit_limit(self, limit: int | None = None) -> None:
        self._open_session().raise_unit_limit(limit)

    def pad_units(self, multiple: int) -> None:
        # Pad what is sent from now on to a multiple of so many bytes; 0: do not.
        if self._session is not None:  # else nothing is sent any more
            self._session.pad = multiple

    def _open_session(self) -> Session:
        if self._session is None:
            raise errors.ChannelClosed("the connection is closed")
        return self._session

    # -- sending

    def seal_unit(self, *pieces: Bytes, reuse: bool = False) -> Iterator[Bytes]:
        # With `reuse` a record holds until the next is taken: write it, or copy it, before that. A unit that
        # has begun must be finished: if that is not possible, drop the connection.
        self._sendable().check_unit(pieces)
        return self._sealed(pieces, reuse=reuse)

    def seal_small(self, unit: Bytes) -> Bytes | None:
        # None: it does not apply, use `seal_unit`.
        small = 0 < len(unit) <= min(ONE_RECORD, self._limits.unit)
        if self._out or self._sealing or not small or self.state not in SENDING or self._session is None:
            return None
        return self._session.seal_small(unit)

    def _sealed(self, pieces: Sequence[Bytes], *, reuse: bool) -> Iterator[Bytes]:
        if self._sealing:
            raise errors.ProtocolViolation("a second unit in the middle of the first")
        self._sealing = True
        try:
            for record in self._sendable().seal_unit(pieces, reuse=reuse):
                # A record sealed meanwhile has the smaller counter: it goes first.
                yield b"".join((self.data_to_send(), record)) if self._out else record
                self._sendable()
            self._sealing = False  # it stays set when a unit is abandoned
        except errors.LimitExceeded:
            self._terminate()
            raise

    def _sendable(self) -> Session:
        if self.state not in SENDING:
            raise errors.ChannelClosed("the connection is closed")
        return self._open_session()

    def send_unit(self, *pieces: Bytes) -> None:
        records = list(self.seal_unit(*pieces))  # takes what was queued before
        self._out += records

    # -- what is renewed

    @property
    def takes_renewals(self) -> bool:
        return self._renewals is not None and self.state is ConnectionState.OPEN

    def present_identity(self, chain: Sequence[bytes]) -> None:
        # Queue this side's certificates, unless the peer has them; before the end of the handshake they are
        # queued then. Nothing for a peer that takes none.
        self._own_chain = chain
        if chain and self._renewals is not None and self.takes_renewals:
            data = self._renewals.own(chain)
            if data is not None:
                self._out.append(self._open_session().seal_renewal(Frame.IDENTITY, data))

    def present_grants(self, data: bytes) -> bool:
        # On a connection for calls they are presented by a call.
        if not (self.takes_renewals and self.protocol is WireProtocol.TCPROS):
            return False
        if not 0 < len(data) <= MAX_GRANTS:
            raise errors.LimitExceeded(f"{len(data)} bytes of grants, where 1 to {MAX_GRANTS} are allowed")
        self._out.append(self._open_session().seal_renewal(Frame.GRANTS, data))
        return True

    @property
    def has_data_to_send(self) -> bool:
        return any(self._out)

    @property
    def awaits_peer(self) -> bool:
        return self._session is not None and self._session.awaits_peer

    def data_to_send(self) -> Bytes:
        if not self._out:
            return b""
        out, self._out = self._out, []
        return out[0] if len(out) == 1 else b"".join(out)

    def put_back(self, rest: Bytes) -> None:
        # Put what could not be written yet in front of the queue.
        if rest:
            self._out.insert(0, rest)

    def close(self) -> None:
        if self.state in SENDING:
            self._out.append(self._sendable().close_record())
            self._session = None
            self.state = ConnectionState.CLOSING
        elif self.state is not ConnectionState.CLOSING:
            self.state = ConnectionState.CLOSED

    def abandon(self) -> None:
        # Forget keys and counters at once; nothing is sent (a forked process must not).
        self._terminate()

    # -- time and ends

    def deadline(self) -> int | None:
        if self.state in ENDED:
            return None
        if self.state is not ConnectionState.OPEN or self._session is None or self._peer is None:
            return self._handshake_deadline
        unit = self._session.deadline
        last = min(self._session.renew_at, self._peer.not_after)
        return last if unit is None else min(last, unit)

    def tick(self, now: int, *, reading: bool = True) -> None:
        # While the shell is not `reading`, the peer cannot complete a unit: no time-out for it.
        self._now = now
        deadline = self.deadline()
        if deadline is None or now < deadline:
            return
        try:
            if self.state is not ConnectionState.OPEN or self._session is None or self._peer is None:
                raise errors.HandshakeTimeout("the peer did not finish the handshake in time", HINT_SILENT)
            if now >= self._peer.not_after:
                raise errors.LimitExceeded("the peer's certificate has expired", "renew it")
            self._session.check_progress(now, reading=reading)
            self._out.append(self._session.renew(now))
        except errors.ChannelError:
            self._terminate()
            raise

    def _terminate(self) -> None:
        # End; an error, which others may keep, must not keep what was received alive.
        self.state = ConnectionState.CLOSED
        if self._session is not None:
            self._session.discard()
        self._session = None
        self._buffer.clear()
        self._forget_handshake()
        self._out = []

    def _forget_handshake(self) -> None:
        # Its plaintexts, certificates and ephemeral keys; the secrets also where a traceback keeps it.
        if self._negotiation is not None:
            self._negotiation.forget()
            self._negotiation = None

    # -- receiving

    def get_buffer(self, shared: memoryview | None = None) -> memoryview:
        # For the next bytes: `shared`, if there is nothing they continue, else memory of this connection. The
        # caller's other connections may read into `shared` once this one has been told what came.
        return self._buffer.free(shared if self.state is ConnectionState.OPEN else None)

    def lone_unit(self, count: int) -> bytes | None:
        """The unit, if the `count` bytes just read are exactly one record that ends it: nearly every message
        outside of a burst, without what frames and events cost. None: nothing has happened, and the bytes are
        for `buffer_updated`, which also says what is wrong with a header."""
        session, record = self._session, self._buffer.arrived(count)
        if self.state is not ConnectionState.OPEN or session is None or record is None:
            return None
        head = record[:HEADER].tobytes()
        if not session.ends_unit(head, count):
            return None
        self._buffer.filled(count)
        try:
            unit = session.data_end(head, record[HEADER:])
        except BaseException:
            self._terminate()
            raise
        self._buffer.consume(count)
        return unit

    def buffer_updated(self, count: int, now: int) -> list[Event[PeerT]]:
        self._now = now
        self._buffer.filled(count)
        events: list[Event[PeerT]] = []
        self._events = events
        try:
            self._process_frames()
            self._buffer.keep()
        except errors.ChannelError as error:
            refusal = _UNKNOWN if isinstance(error, errors.PeerCredentialUnknown) else _REFUSED
            # End; send an error to a peer not authenticated yet, unless it sent one first.
            steps = self._negotiation
            answer = self.state in negotiation.UNAUTHENTICATED and not (steps and steps.peer_sent_error)
            out = self._out if self.state in negotiation.UNAUTHENTICATED | PREAMBLE else []
            self._terminate()
            self._out = [*out, refusal] if answer else out
            raise
        except BaseException:
            self._terminate()  # a bug ends the connection as well
            raise
        finally:
            del self._events  # its units may be long, and this connection idle from here on
        return events

    def receive_eof(self) -> None:
        if self.state in ENDED:
            self.state = ConnectionState.CLOSED
            return
        opened = self.state is ConnectionState.OPEN
        self._terminate()
        if opened:
            raise errors.ConnectionTruncated(
                "the connection ended without the peer's close",
                "data may be missing: the peer crashed, or something reset the connection",
            )
        raise errors.HandshakeFailed("the peer ended the connection during the handshake", HINT_SILENT)

    def _process_frames(self) -> None:
        if self.state in PREAMBLE:
            try:
                self.state = self._preamble.feed(self._buffer, self.state)
            finally:
                self._out.append(self._preamble.take())
            if self.state is ConnectionState.DRAINING:
                self._buffer.enlarge(SMALL)
        buffer = self._buffer
        while self.state in FRAMED:
            view = buffer.unread()
            head = view[:HEADER].tobytes()
            if len(head) < HEADER:
                return
            row, length = self._parse_header(head)
            size = HEADER + length
            if len(view) < size:
                # A frame has begun whose header was checked; a stranger's gets room as it arrives.
                if self._session is not None:
                    if head[0] >> 4 not in _RENEWING:
                        self._session.check_room(length)
                    buffer.expect(size, _OPEN_BUFFER if size < _OPEN_BUFFER else _FULL_BUFFER)
                return
            self._handle_frame(row, head, view[HEADER:size])
            buffer.consume(size)
        if self.state in ENDED:
            buffer.consume(len(buffer))

    def _parse_header(self, head: bytes) -> tuple[negotiation.Row, int]:
        row = _ROWS[self.state].get(head[0] >> 4)
        if row is None or (head[0] >> 4 in _RENEWING and self._renewals is None):
            raise errors.ProtocolViolation(f"frame of type {head[0] >> 4} in state: {self.state.value}")
        epoch = 0 if self._session is None else self._session.receive_epoch
        length = check_header(head, epoch)
        if self.state is ConnectionState.WAIT_1 and length > MAX_MESSAGE_1:
            raise errors.ProtocolViolation("a frame of a forbidden length")
        return row, length

    def _handle_frame(self, row: negotiation.Row, head: bytes, body: memoryview) -> None:
        name, following = row
        steps = self._negotiation
        if steps is not None and self.state in HANDSHAKING:
            step = getattr(steps, name)(bytes(body), self._now)
            if step.peer is not None:
                self._peer = step.peer
                self._buffer.enlarge()
                self._session = steps.session(self._limits, self._now)
                self._events.append(negotiation.Authenticated(step.peer))
            elif step.state is ConnectionState.WAIT_3:
                self._buffer.enlarge(SMALL)
            if step.reply:
                self._out.append(step.reply)
            if step.state is ConnectionState.OPEN:
                self._renewals = steps.renewals(self._now)
                self._forget_handshake()
                self.state = step.state
                self.present_identity(self._own_chain)
            state = step.state
        else:
            state = getattr(self, name)(head, body)
        if state not in following:
            raise RuntimeError(f"{name} led to state {state}, which the state table does not allow")
        self.state = state

    # -- records: the rows of the table for an open connection

    def _on_data(self, head: bytes, body: memoryview) -> ConnectionState:
        self._open_session().data(head, body, self._now)
        return ConnectionState.OPEN

    def _on_data_end(self, head: bytes, body: memoryview) -> ConnectionState:
        self._events.append(UnitReceived(self._open_session().data_end(head, body)))
        return ConnectionState.OPEN

    def _on_padded_end(self, head: bytes, body: memoryview) -> ConnectionState:
        self._events.append(UnitReceived(self._open_session().padded_end(head, body)))
        return ConnectionState.OPEN

    def _on_rekey(self, head: bytes, body: memoryview) -> ConnectionState:
        self._out.append(self._open_session().rekey(head, body))
        return ConnectionState.OPEN

    def _on_identity(self, head: bytes, body: memoryview) -> ConnectionState:
        renewals, data = self._renewal(head, body)
        if self._peer is not None:
            try:
                self._peer = renewals.identity(data, self._peer, self._now)
                self._events.append(negotiation.IdentityRenewed(self._peer))
            except HintedError as error:
                self._events.append(negotiation.PresentedRenewalRefused(error.bare()))
        return ConnectionState.OPEN

    def _on_grants(self, head: bytes, body: memoryview) -> ConnectionState:
        _, data = self._renewal(head, body)
        if self.protocol is not WireProtocol.TCPROS:
            raise errors.ProtocolViolation("grants on a connection for calls")
        self._events.append(negotiation.GrantsPresented(data))
        return ConnectionState.OPEN

    def _renewal(self, head: bytes, body: memoryview) -> tuple[negotiation.ConnectionRenewals[PeerT], bytes]:
        data = self._open_session().open_renewal(head, body)
        if self._renewals is None:
            raise errors.ProtocolViolation("a renewal where none is taken")
        self._renewals.charge(self._now)
        return self._renewals, data

    def _on_close(self, head: bytes, body: memoryview) -> ConnectionState:
        session = self._open_session()
        session.close(head, body)
        self._out.append(session.close_record())
        self._session = None
        self._events.append(negotiation.Closed())
        return ConnectionState.CLOSED

"""One secure connection without its socket: bytes and `now` in, events and bytes out.

`states.TABLE` is its state machine. Any error ends it: nothing is delivered or sent afterwards,
except one last flight that tells a peer not authenticated yet that it was refused, in one generic
text (no oracle). Verified units of the same call are dropped with the connection. The caller writes
all bytes it is given, in order and at once, or drops the connection.
"""

from collections.abc import Collection
from typing import Final, Self

from rossec.channel.edhoc.credentials import OwnCredential, PeerT, Verify
from rossec.channel.edhoc.handshake import Responder
from rossec.channel.edhoc.known import KnownCertificates
from rossec.channel.edhoc.messages import UNKNOWN_CREDENTIAL, UNSPECIFIED, encode_error
from rossec.channel.edhoc.own_dials import OwnDials
from rossec.channel.edhoc.peer import EdhocConfig
from rossec.channel.edhoc.suites import PRODUCTION, Random
from rossec.channel.negotiation import Negotiation, NegotiationStep, Preamble
from rossec.channel.opening import WireProtocol
from rossec.channel.outbound import HINT_SILENT, Outbound
from rossec.channel.records import (
    HEADER,
    MAX_PLAINTEXT,
    TAG,
    Bytes,
    ChannelLimits,
    Frame,
    check_header,
    frame,
)
from rossec.channel.states import (
    ENDED,
    FRAMED,
    HANDSHAKING,
    PREAMBLE,
    TABLE,
    UNAUTHENTICATED,
    Authenticated,
    Closed,
    ConnectionState,
    Event,
    Row,
    UnitReceived,
)
from rossec.errors import (
    ChannelError,
    ConnectionTruncated,
    HandshakeFailed,
    PeerCredentialUnknown,
    ProtocolViolation,
)

_OPEN_BUFFER: Final = 64 * 1024
_FULL_BUFFER: Final = 2 * (HEADER + MAX_PLAINTEXT + TAG)  # two whole records stay aligned
_REFUSED: Final = frame(Frame.ERROR, encode_error(UNSPECIFIED, "handshake refused"))
_UNKNOWN: Final = frame(Frame.ERROR, encode_error(UNKNOWN_CREDENTIAL, info=True))
_DEFAULTS: Final = ChannelLimits()
_BOTH: Final = frozenset(WireProtocol)


class Connection(Outbound[PeerT]):
    """A connection of either role: make one with `initiator` or `responder`."""

    @classmethod
    def initiator(
        cls,
        credentials: OwnCredential,
        verify: Verify[PeerT],
        *,
        random: Random,
        now: int,
        opening: WireProtocol = WireProtocol.TCPROS,
        suites: tuple[int, ...] = PRODUCTION,
        limits: ChannelLimits = _DEFAULTS,
        known: KnownCertificates | None = None,
        request_x5t: bool = False,
        own_dials: OwnDials | None = None,
    ) -> Self:
        """The side that connected; its first flight is ready to send.

        With `known` certificates are cached, and `request_x5t` asks the responder to send a hash of
        its own: for an address where a known peer was reached before. `OwnCredentialUnknown` and
        `PeerCredentialUnknown` mean: forget the introductions, and retry without `request_x5t`.
        With `own_dials`, which this node's listeners share, it means to reach itself, and no other
        peer is accepted.
        """
        config = EdhocConfig(
            credentials,
            verify,
            random,
            suites,
            known=known,
            request_x5t=request_x5t,
            own_dials=own_dials,
        )
        negotiation, message_1 = Negotiation.begin(config)
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
        accept: Collection[WireProtocol] = _BOTH,
        suites: tuple[int, ...] = PRODUCTION,
        limits: ChannelLimits = _DEFAULTS,
        known: KnownCertificates | None = None,
        own_dials: OwnDials | None = None,
    ) -> Self:
        """The side that was connected to; `accept` says which openings are accepted.

        With `own_dials` this node may connect to itself, for dials noted there.
        """
        config = EdhocConfig(credentials, verify, random, suites, known=known, own_dials=own_dials)
        preamble = Preamble(WireProtocol.TCPROS, accept)
        return cls(preamble, Negotiation(Responder(config)), now, limits)

    # -- receiving

    def get_buffer(self) -> memoryview:
        """Where the next bytes from the socket go; valid until the next call of any method."""
        return self._buffer.free()

    def receive_data(self, data: Bytes, now: int) -> list[Event[PeerT]]:
        """Take bytes from the peer. `get_buffer` and `buffer_updated` save the copy.

        Raises:
            ChannelError: the connection has ended; `data_to_send` may hold a last flight.
        """
        events: list[Event[PeerT]] = []
        rest = memoryview(data)
        while len(rest) > 0:
            room = self._buffer.free()
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
        self._buffer.filled(count)
        events = self._events = []
        try:
            self._process_frames()
        except ChannelError as error:
            self._last_flight(_UNKNOWN if isinstance(error, PeerCredentialUnknown) else _REFUSED)
            raise
        except BaseException:
            self._terminate()  # a bug ends the connection as well
            raise
        return events

    def receive_eof(self) -> None:
        """The peer ended the TCP stream.

        Raises:
            ConnectionTruncated: without its authenticated close.
            HandshakeFailed: before the handshake was done.
        """
        if self.state in ENDED:
            self.state = ConnectionState.CLOSED
            return
        opened = self.state is ConnectionState.OPEN
        self._terminate()
        if opened:
            raise ConnectionTruncated(
                "the connection ended without the peer's close",
                "data may be missing: the peer crashed, or something reset the connection",
            )
        raise HandshakeFailed(
            "the peer ended the connection during the handshake",
            HINT_SILENT,
        )

    def _process_frames(self) -> None:
        if self.state in PREAMBLE:
            self._feed_preamble()
        buffer = self._buffer
        while self.state in FRAMED:
            view = buffer.unread()
            head = view[:HEADER].tobytes()
            if len(head) < HEADER:
                return
            row, length = self._parse_header(head)
            size = HEADER + length
            if len(view) < size:
                buffer.reserve(size, _OPEN_BUFFER if size < _OPEN_BUFFER else _FULL_BUFFER)
                return
            self._handle_frame(row, head, view[HEADER:size])
            buffer.consume(size)
        if self.state in ENDED:
            buffer.consume(len(buffer))

    def _feed_preamble(self) -> None:
        try:
            self.state = self._preamble.feed(self._buffer, self.state)
        finally:
            self._out.append(self._preamble.take())

    def _parse_header(self, head: bytes) -> tuple[Row, int]:
        row = _ROWS[self.state].get(head[0] >> 4)
        if row is None:
            raise ProtocolViolation(f"frame of type {head[0] >> 4} in state: {self.state.value}")
        epoch = 0 if self._session is None else self._session.receive_epoch
        return row, check_header(head, epoch)

    def _handle_frame(self, row: Row, head: bytes, body: memoryview) -> None:
        name, following = row
        if self.state in HANDSHAKING:
            state = self._apply_step(getattr(self._negotiation, name)(bytes(body), self._now))
        else:
            state = getattr(self, name)(head, body)
        if state not in following:
            raise RuntimeError(f"{name} led to state {state}, which the state table does not allow")
        self.state = state

    def _apply_step(self, step: NegotiationStep[PeerT]) -> ConnectionState:
        if step.peer is not None:
            self._peer = step.peer
            self._buffer.enlarge()
            self._session = self._negotiation.session(self._limits, self._now)
            self._events.append(Authenticated(step.peer))
        if step.reply:
            self._out.append(step.reply)
        if step.state is ConnectionState.OPEN:
            self._negotiation.forget()
        return step.state

    # -- records: the rows of the table for an open connection

    def _on_data(self, head: bytes, body: memoryview) -> ConnectionState:
        self._open_session().data(head, body, self._now)
        return ConnectionState.OPEN

    def _on_data_end(self, head: bytes, body: memoryview) -> ConnectionState:
        self._events.append(UnitReceived(self._open_session().data_end(head, body)))
        return ConnectionState.OPEN

    def _on_rekey(self, head: bytes, body: memoryview) -> ConnectionState:
        self._out.append(self._open_session().rekey(head, body))
        return ConnectionState.OPEN

    def _on_close(self, head: bytes, body: memoryview) -> ConnectionState:
        session = self._open_session()
        session.close(head, body)
        self._out.append(session.close_record())
        self._session = None
        self._events.append(Closed())
        return ConnectionState.CLOSED

    def _last_flight(self, refusal: bytes) -> None:
        """End; send an error to a peer not authenticated yet, unless it sent one first."""
        answer = self.state in UNAUTHENTICATED and not self._negotiation.peer_sent_error
        out = self._out if self.state in UNAUTHENTICATED | PREAMBLE else []
        self._terminate()
        self._out = [*out, refusal] if answer else out


_ROWS: Final = {
    state: {kind.value: row for (there, kind), row in TABLE.items() if there is state}
    for state in ConnectionState
}

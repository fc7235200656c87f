"""One secure connection without its socket: bytes and `now` in, events and bytes out.

`states.TABLE` is its state machine. Any error ends it: nothing is delivered or sent afterwards,
except one last flight that tells a peer not authenticated yet that it was refused, in one generic
text (no oracle). Verified units of the same call are dropped with the connection. The caller writes
all bytes it is given, in order and at once, or drops the connection.
"""

from collections.abc import Collection
from typing import Final, Self

from ca.errors import HintedError
from rossec.channel.buffers import FIRST, SMALL
from rossec.channel.edhoc.credentials import OwnCredential, PeerT, Renews, Verify
from rossec.channel.edhoc.handshake import Responder
from rossec.channel.edhoc.known import KnownCertificates
from rossec.channel.edhoc.messages import (
    MAX_MESSAGE_1,
    RENEWALS_EAD,
    UNKNOWN_CREDENTIAL,
    UNSPECIFIED,
    encode_error,
)
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
from rossec.channel.renewals import Renewals
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
    GrantsPresented,
    IdentityRenewed,
    RenewalRefused,
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
_RENEWING: Final = frozenset((Frame.IDENTITY.value, Frame.GRANTS.value))


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
        renews: Renews[PeerT] | None = None,
    ) -> Self:
        """The side that connected; its first flight is ready to send.

        With `known` certificates are cached, and `request_x5t` asks the responder to send a hash of
        its own: for an address where a known peer was reached before. `OwnCredentialUnknown` and
        `PeerCredentialUnknown` mean: forget the introductions, and retry without `request_x5t`.
        With `own_dials`, which this node's listeners share, it means to reach itself, and no other
        peer is accepted. With `renews` the peer is told that renewed certificates and grants are
        taken on the open connection.
        """
        config = EdhocConfig(
            credentials, verify, random, suites, known=known, request_x5t=request_x5t,
            own_dials=own_dials, renews=renews, ead=b"" if renews is None else RENEWALS_EAD,
        )  # fmt: skip
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
        renews: Renews[PeerT] | None = None,
    ) -> Self:
        """The side that was connected to; `accept` says which openings are accepted.

        With `own_dials` this node may connect to itself, for dials noted there. `renews`: as for
        the initiator.
        """
        config = EdhocConfig(
            credentials, verify, random, suites, known=known, own_dials=own_dials,
            renews=renews, ead=b"" if renews is None else RENEWALS_EAD,
        )  # fmt: skip
        preamble = Preamble(WireProtocol.TCPROS, accept)
        return cls(preamble, Negotiation(Responder(config)), now, limits, FIRST)

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
                self._expect(length, in_unit=head[0] >> 4 not in _RENEWING)
                return
            self._handle_frame(row, head, view[HEADER:size])
            buffer.consume(size)
        if self.state in ENDED:
            buffer.consume(len(buffer))

    def _expect(self, length: int, *, in_unit: bool) -> None:
        """A frame has begun whose header was checked; a stranger's gets room as it arrives."""
        if self._session is not None:
            if in_unit:
                self._session.check_room(length)
            size = HEADER + length
            self._buffer.expect(size, _OPEN_BUFFER if size < _OPEN_BUFFER else _FULL_BUFFER)

    def _feed_preamble(self) -> None:
        try:
            self.state = self._preamble.feed(self._buffer, self.state)
        finally:
            self._out.append(self._preamble.take())
        if self.state is ConnectionState.DRAINING:
            self._buffer.enlarge(SMALL)

    def _parse_header(self, head: bytes) -> tuple[Row, int]:
        row = _ROWS[self.state].get(head[0] >> 4)
        if row is None or (head[0] >> 4 in _RENEWING and self._renewals is None):
            raise ProtocolViolation(f"frame of type {head[0] >> 4} in state: {self.state.value}")
        epoch = 0 if self._session is None else self._session.receive_epoch
        length = check_header(head, epoch)
        if self.state is ConnectionState.WAIT_1 and length > MAX_MESSAGE_1:
            raise ProtocolViolation("a frame of a forbidden length")
        return row, length

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
        elif step.state is ConnectionState.WAIT_3:
            self._buffer.enlarge(SMALL)
        if step.reply:
            self._out.append(step.reply)
        if step.state is ConnectionState.OPEN:
            self._renewals = self._negotiation.renewals(self._now)
            self._negotiation.forget()
            self.state = step.state
            self.present_identity(self._own_chain)
        return step.state

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
                self._events.append(IdentityRenewed(self._peer))
            except HintedError as error:
                self._events.append(RenewalRefused(error.bare()))
        return ConnectionState.OPEN

    def _on_grants(self, head: bytes, body: memoryview) -> ConnectionState:
        _, data = self._renewal(head, body)
        if not self._carries_grants:
            raise ProtocolViolation("grants on a connection for calls")
        self._events.append(GrantsPresented(data))
        return ConnectionState.OPEN

    def _renewal(self, head: bytes, body: memoryview) -> tuple[Renewals[PeerT], bytes]:
        data = self._open_session().open_renewal(head, body)
        if self._renewals is None:
            raise ProtocolViolation("a renewal where none is taken")
        self._renewals.charge(self._now)
        return self._renewals, data

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

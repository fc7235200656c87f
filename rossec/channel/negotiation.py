"""The state machine of a connection as one table, its events, and what happens before records flow.

`TABLE` says what a frame does in a state (a method of `Negotiation`, later of `Connection`) and which states
may follow. A frame that is not in the table ends the connection; the diagram in docs/spec/channel.md is drawn
from it. Each step of the handshake takes what the peer sent and returns the next state and the reply; the
connection applies both.
"""

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from enum import Enum
from typing import Final, Generic, NamedTuple, TypeAlias, cast

from ca.encoding import decode
from ca.errors import EncodingError, HintedError
from rossec import errors
from rossec.channel import opening
from rossec.channel.edhoc import messages
from rossec.channel.edhoc.credentials import PeerT, Renews, Verify, by_value, encode_id_cred, x5chain
from rossec.channel.edhoc.handshake import Initiator, Responder, WrongSuite
from rossec.channel.opening import WireProtocol
from rossec.channel.records import ChannelLimits, Epochs, Frame, frame
from rossec.channel.session import ReceiveBuffer, Session

# A peer may present so many renewals at once, and then one in so many seconds: each costs signatures to
# verify.
MOST_AT_ONCE: Final = 12
SECONDS_EACH: Final = 2

_HINT_REFUSED: Final = "see the peer's log: it does not give reasons to an untrusted peer"
_HINT_AGAIN: Final = "connect again: the whole certificate will be sent"


class ConnectionState(Enum):
    OPENING = "opening"
    DRAINING = "draining"
    WAIT_1 = "wait for message_1"
    WAIT_2 = "wait for message_2"
    WAIT_3 = "wait for message_3"
    WAIT_4 = "wait for message_4"
    OPEN = "open"
    CLOSING = "closing"
    CLOSED = "closed"

    __hash__ = object.__hash__  # members are unique; Enum's own hash is Python, for every look-up


Row: TypeAlias = tuple[str, tuple[ConnectionState, ...]]

TABLE: Final[dict[tuple[ConnectionState, Frame], Row]] = {
    (ConnectionState.WAIT_1, Frame.HANDSHAKE): (
        "on_message_1",
        (ConnectionState.WAIT_3, ConnectionState.WAIT_1),
    ),
    (ConnectionState.WAIT_2, Frame.HANDSHAKE): ("on_message_2", (ConnectionState.WAIT_4,)),
    (ConnectionState.WAIT_2, Frame.ERROR): ("on_error", (ConnectionState.WAIT_2,)),
    (ConnectionState.WAIT_3, Frame.HANDSHAKE): ("on_message_3", (ConnectionState.OPEN,)),
    (ConnectionState.WAIT_3, Frame.ERROR): ("on_error", ()),
    (ConnectionState.WAIT_4, Frame.HANDSHAKE): ("on_message_4", (ConnectionState.OPEN,)),
    (ConnectionState.WAIT_4, Frame.ERROR): ("on_error", ()),
    (ConnectionState.OPEN, Frame.DATA): ("_on_data", (ConnectionState.OPEN,)),
    (ConnectionState.OPEN, Frame.DATA_END): ("_on_data_end", (ConnectionState.OPEN,)),
    (ConnectionState.OPEN, Frame.PADDED_END): ("_on_padded_end", (ConnectionState.OPEN,)),
    (ConnectionState.OPEN, Frame.REKEY): ("_on_rekey", (ConnectionState.OPEN,)),
    (ConnectionState.OPEN, Frame.CLOSE): ("_on_close", (ConnectionState.CLOSED,)),
    (ConnectionState.OPEN, Frame.IDENTITY): ("_on_identity", (ConnectionState.OPEN,)),
    (ConnectionState.OPEN, Frame.GRANTS): ("_on_grants", (ConnectionState.OPEN,)),
}
"""Errors are unauthenticated, so they are not accepted once the handshake is done."""

PREAMBLE: Final = frozenset({ConnectionState.OPENING, ConnectionState.DRAINING})
UNAUTHENTICATED: Final = frozenset({ConnectionState.WAIT_1, ConnectionState.WAIT_2, ConnectionState.WAIT_3})
HANDSHAKING: Final = UNAUTHENTICATED | {ConnectionState.WAIT_4}
FRAMED: Final = HANDSHAKING | {ConnectionState.OPEN}
SENDING: Final = frozenset({ConnectionState.WAIT_4, ConnectionState.OPEN})
ENDED: Final = frozenset({ConnectionState.CLOSING, ConnectionState.CLOSED})


@dataclass(frozen=True, slots=True)
class Authenticated(Generic[PeerT]):
    """The peer proved that it holds the certified key; from here on this side may send. An initiator may
    still be refused until the responder's message_4 arrives."""

    identity: PeerT


@dataclass(frozen=True, slots=True)
class UnitReceived:
    data: bytes


@dataclass(frozen=True, slots=True)
class Closed:
    """The peer closed in order: it sends nothing more and reads nothing more."""


@dataclass(frozen=True, slots=True)
class IdentityRenewed(Generic[PeerT]):
    """The peer's certificate was renewed: from here on this is its identity."""

    identity: PeerT


@dataclass(frozen=True, slots=True)
class PresentedRenewalRefused:
    reason: HintedError


@dataclass(frozen=True, slots=True)
class GrantsPresented:
    """Grants the peer presents in place of those before; nothing in them was verified."""

    data: bytes


Renewal: TypeAlias = IdentityRenewed[PeerT] | PresentedRenewalRefused | GrantsPresented
Event: TypeAlias = Authenticated[PeerT] | UnitReceived | Closed | Renewal[PeerT]


class ConnectionRenewals(Generic[PeerT]):
    """Of one connection between sides that both take renewals; grants pass unread.

    A renewed certificate is verified as one in the handshake is, and must be of the same key and name: who
    holds the key was proven then. One that is refused changes nothing.
    `sent`: the certificate that this side sent in the handshake; `now`: when the connection opened.
    """

    __slots__ = ("_charged_at", "_left", "_renews", "_sent", "_verify")

    def __init__(self, verify: Verify[PeerT], renews: Renews[PeerT], sent: bytes, now: int) -> None:
        self._verify = verify
        self._renews = renews
        self._sent = sent
        self._left = MOST_AT_ONCE * SECONDS_EACH
        self._charged_at = now

    def charge(self, now: int) -> None:
        passed = max(0, now - self._charged_at)
        self._charged_at = now
        self._left = min(MOST_AT_ONCE * SECONDS_EACH, self._left + passed) - SECONDS_EACH
        if self._left < 0:
            raise errors.LimitExceeded("the peer presents certificates or grants too often")

    def identity(self, data: bytes, held: PeerT, now: int) -> PeerT:
        try:
            value = decode(data, limit=messages.MAX_MESSAGE)
        except EncodingError as error:
            raise errors.HandshakeFailed(f"an unreadable certificate: {error}") from None
        renewed = self._verify(x5chain(value), now)
        if not self._renews(renewed, held):
            raise errors.IdentityRefused(
                "the certificate is another node's, not this one's renewed",
                "a certificate with another key or name needs a new connection",
            )
        return renewed

    def own(self, chain: Sequence[bytes]) -> bytes | None:
        if chain[0] == self._sent:
            return None
        self._sent = chain[0]
        return encode_id_cred(by_value(chain))


class Preamble:
    """The bytes before the first frame, of either role; `accept` makes it a responder's."""

    __slots__ = ("_accept", "_drain", "_reply", "protocol")

    def __init__(self, protocol: WireProtocol, accept: Collection[WireProtocol] | None) -> None:
        self.protocol = protocol
        self._reply = b"" if accept is not None else opening.first_bytes(protocol)
        self._accept = accept
        self._drain = 0

    def take(self) -> bytes:
        reply, self._reply = self._reply, b""
        return reply

    def feed(self, buffer: ReceiveBuffer, state: ConnectionState) -> ConnectionState:
        if state is ConnectionState.OPENING:
            prefix = bytes(buffer.unread()[: opening.MAX_OPENING])
            if self._accept is None:
                length = opening.classify_answer(prefix, self.protocol)
                if length is None:
                    return ConnectionState.OPENING
                buffer.consume(length)
                return ConnectionState.WAIT_2
            state = self._call(buffer, opening.classify_caller(prefix), self._accept)
        if state is ConnectionState.DRAINING:
            count = min(self._drain, len(buffer))
            buffer.consume(count)
            self._drain -= count
            if self._drain == 0:
                self._refuse()
        return state

    def _call(
        self, buffer: ReceiveBuffer, verdict: opening.Verdict, accept: Collection[WireProtocol]
    ) -> ConnectionState:
        if verdict is None:
            return ConnectionState.OPENING
        self.protocol = verdict.protocol
        if isinstance(verdict, opening.PlainCaller):
            self._drain = verdict.drain
            return ConnectionState.DRAINING
        if verdict.protocol not in accept:
            self._refuse()
        buffer.consume(verdict.consumed)
        self._reply = verdict.reply
        return ConnectionState.WAIT_1

    def _refuse(self) -> None:
        self._reply = opening.refusal(self.protocol)
        raise errors.PlainPeer(
            f"a plain {self.protocol.name} peer called and was refused", opening.HINT_PLAIN
        )


class NegotiationStep(NamedTuple, Generic[PeerT]):
    state: ConnectionState
    reply: bytes = b""
    peer: PeerT | None = None


class Negotiation(Generic[PeerT]):
    __slots__ = ("_edhoc", "_retried", "_unconfirmed_peer", "peer_sent_error")

    def __init__(self, edhoc: Initiator[PeerT] | Responder[PeerT]) -> None:
        self._edhoc = edhoc
        self._retried = False
        self._unconfirmed_peer: PeerT | None = None
        self.peer_sent_error = False  # an error is never answered with an error

    def session(self, limits: ChannelLimits, now: int) -> Session:
        # The record layer under the secret both sides now share.
        edhoc = self._edhoc
        epochs = Epochs(edhoc.suite, edhoc.exporter, initiator=isinstance(edhoc, Initiator))
        return Session(epochs, limits, now)

    def renewals(self, now: int) -> ConnectionRenewals[PeerT] | None:
        config, edhoc = self._edhoc.config, self._edhoc
        if config.renews is None or not edhoc.peer_renews:
            return None
        return ConnectionRenewals(config.verify, config.renews, edhoc.sent, now)

    def forget(self) -> None:
        self._edhoc.forget()

    def on_message_1(self, body: bytes, _: int) -> NegotiationStep[PeerT]:
        edhoc = cast("Responder[PeerT]", self._edhoc)
        try:
            return NegotiationStep(ConnectionState.WAIT_3, frame(Frame.HANDSHAKE, edhoc.on_message_1(body)))
        except WrongSuite as error:
            if self._retried:
                raise
            self._retried = True
            text = messages.encode_error(messages.WRONG_SUITE, messages.suites_item(error.suites))
            return NegotiationStep(ConnectionState.WAIT_1, frame(Frame.ERROR, text))

    def on_message_2(self, body: bytes, now: int) -> NegotiationStep[PeerT]:
        edhoc = cast("Initiator[PeerT]", self._edhoc)
        message_3, peer = edhoc.on_message_2(body, now)
        if edhoc.send_x5t:  # the responder may not know the certificate: send nothing before message_4
            self._unconfirmed_peer = peer
        peer_now = None if edhoc.send_x5t else peer
        return NegotiationStep(ConnectionState.WAIT_4, frame(Frame.HANDSHAKE, message_3), peer_now)

    def on_message_3(self, body: bytes, now: int) -> NegotiationStep[PeerT]:
        edhoc = cast("Responder[PeerT]", self._edhoc)
        message_4, peer = edhoc.on_message_3(body, now)
        return NegotiationStep(ConnectionState.OPEN, frame(Frame.HANDSHAKE, message_4), peer)

    def on_message_4(self, body: bytes, _: int) -> NegotiationStep[PeerT]:
        cast("Initiator[PeerT]", self._edhoc).on_message_4(body)
        return NegotiationStep(ConnectionState.OPEN, peer=self._unconfirmed_peer)

    def on_error(self, body: bytes, _: int) -> NegotiationStep[PeerT]:
        # Fail, or retry where the peer only requires another suite.
        self.peer_sent_error = True
        code, reason, suites = messages.decode_error(body)
        edhoc = self._edhoc
        if code == messages.UNKNOWN_CREDENTIAL:
            raise errors.OwnCredentialUnknown(f"the peer refused the handshake: {reason}", _HINT_AGAIN)
        fresh = isinstance(edhoc, Initiator) and not edhoc.answered and not self._retried
        if code != messages.WRONG_SUITE or not fresh:
            raise errors.PeerRefused(f"the peer refused the handshake: {reason}", _HINT_REFUSED)
        self._edhoc = renewed = cast("Initiator[PeerT]", edhoc).after_wrong_suite(suites)
        self._retried, self.peer_sent_error = True, False
        return NegotiationStep(ConnectionState.WAIT_2, frame(Frame.HANDSHAKE, renewed.make_message_1()))

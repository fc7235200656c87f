"""What happens before records flow: the preamble, then the handshake message by message.

Each step takes what the peer sent and returns the next state and the reply; the connection applies
both. `Preamble` is for the bytes before the first frame, `Negotiation` holds the
rows of `states.TABLE` for the handshake.
"""

from collections.abc import Collection
from typing import Final, Generic, NamedTuple, cast

from rossec.channel.buffers import ReceiveBuffer
from rossec.channel.edhoc.credentials import PeerT
from rossec.channel.edhoc.handshake import Initiator, Responder, WrongSuite
from rossec.channel.edhoc.messages import (
    UNKNOWN_CREDENTIAL,
    WRONG_SUITE,
    decode_error,
    encode_error,
    suites_item,
)
from rossec.channel.edhoc.peer import EdhocConfig
from rossec.channel.opening import (
    MAX_OPENING,
    PlainCaller,
    Verdict,
    WireProtocol,
    classify_answer,
    classify_caller,
    first_bytes,
    refusal,
)
from rossec.channel.records import ChannelLimits, Epochs, Frame, frame
from rossec.channel.renewals import Renewals
from rossec.channel.session import Session
from rossec.channel.states import ConnectionState
from rossec.errors import OwnCredentialUnknown, PeerRefused, PlainPeer

_HINT_REFUSED: Final = "see the peer's log: it does not give reasons to an untrusted peer"
_HINT_AGAIN: Final = "connect again: the whole certificate will be sent"
_HINT_PLAIN: Final = "the peer is a plain ROS node: give it an identity, or use another address"


class Preamble:
    """The bytes before the first frame, of either role; `accept` makes it a responder's."""

    def __init__(self, protocol: WireProtocol, accept: Collection[WireProtocol] | None) -> None:
        self.protocol = protocol
        self._reply = b"" if accept is not None else first_bytes(protocol)
        self._accept = accept
        self._drain = 0

    def take(self) -> bytes:
        """Return, once, what to send."""
        reply, self._reply = self._reply, b""
        return reply

    def feed(self, buffer: ReceiveBuffer, state: ConnectionState) -> ConnectionState:
        """Consume what belongs to the preamble; return the state that follows.

        Raises:
            PlainPeer: the peer speaks plain ROS; `take` may hold a readable refusal.
            ProtocolViolation: the peer speaks neither.
        """
        if state is ConnectionState.OPENING:
            prefix = bytes(buffer.unread()[:MAX_OPENING])
            if self._accept is None:
                return self._answer(buffer, classify_answer(prefix, self.protocol))
            state = self._call(buffer, classify_caller(prefix), self._accept)
        if state is ConnectionState.DRAINING:
            count = min(self._drain, len(buffer))
            buffer.consume(count)
            self._drain -= count
            if self._drain == 0:
                self._refuse()
        return state

    def _answer(self, buffer: ReceiveBuffer, length: int | None) -> ConnectionState:
        if length is None:
            return ConnectionState.OPENING
        buffer.consume(length)
        return ConnectionState.WAIT_2

    def _call(
        self, buffer: ReceiveBuffer, verdict: Verdict, accept: Collection[WireProtocol]
    ) -> ConnectionState:
        if verdict is None:
            return ConnectionState.OPENING
        self.protocol = verdict.protocol
        if isinstance(verdict, PlainCaller):
            self._drain = verdict.drain
            return ConnectionState.DRAINING
        if verdict.protocol not in accept:
            self._refuse()
        buffer.consume(verdict.consumed)
        self._reply = verdict.reply
        return ConnectionState.WAIT_1

    def _refuse(self) -> None:
        self._reply = refusal(self.protocol)
        raise PlainPeer(f"a plain {self.protocol.name} peer called and was refused", _HINT_PLAIN)


class NegotiationStep(NamedTuple, Generic[PeerT]):
    """The result of a message; `peer` once it is authenticated."""

    state: ConnectionState
    reply: bytes = b""
    peer: PeerT | None = None


class Negotiation(Generic[PeerT]):
    """The handshake of one connection, with at most one retry for another cipher suite."""

    def __init__(self, edhoc: Initiator[PeerT] | Responder[PeerT]) -> None:
        self._edhoc = edhoc
        self._retried = False
        self._unconfirmed_peer: PeerT | None = None
        self.peer_sent_error = False  # an error is never answered with an error

    @classmethod
    def begin(cls, config: EdhocConfig[PeerT]) -> tuple["Negotiation[PeerT]", bytes]:
        """An initiator's, and the frame with its message_1."""
        edhoc = Initiator(config)
        return cls(edhoc), frame(Frame.HANDSHAKE, edhoc.message_1())

    def session(self, limits: ChannelLimits, now: int) -> Session:
        """The record layer under the secret both sides now share."""
        edhoc = self._edhoc
        epochs = Epochs(edhoc.suite, edhoc.exporter, initiator=isinstance(edhoc, Initiator))
        return Session(epochs, limits, now)

    def renewals(self, now: int) -> Renewals[PeerT] | None:
        """What is renewed on the open connection; None: one of the sides takes nothing."""
        config, edhoc = self._edhoc.config, self._edhoc
        if config.renews is None or not edhoc.peer_renews:
            return None
        return Renewals(config.verify, config.renews, edhoc.sent, now)

    def forget(self) -> None:
        """Drop the secrets."""
        self._edhoc.forget()

    def on_message_1(self, body: bytes, _: int) -> NegotiationStep[PeerT]:
        """Answer message_1 with message_2, or once with SUITES_R."""
        edhoc = cast("Responder[PeerT]", self._edhoc)
        try:
            return NegotiationStep(
                ConnectionState.WAIT_3, frame(Frame.HANDSHAKE, edhoc.message_1(body))
            )
        except WrongSuite as error:
            if self._retried:
                raise
            self._retried = True
            text = encode_error(WRONG_SUITE, suites_item(error.suites))
            return NegotiationStep(ConnectionState.WAIT_1, frame(Frame.ERROR, text))

    def on_message_2(self, body: bytes, now: int) -> NegotiationStep[PeerT]:
        """Answer message_2 with message_3; the responder is authenticated."""
        edhoc = cast("Initiator[PeerT]", self._edhoc)
        message_3, peer = edhoc.message_2(body, now)
        if (
            edhoc.send_x5t
        ):  # the responder may not know the certificate: send nothing before message_4
            self._unconfirmed_peer, peer_now = peer, None
        else:
            peer_now = peer
        return NegotiationStep(ConnectionState.WAIT_4, frame(Frame.HANDSHAKE, message_3), peer_now)

    def on_message_3(self, body: bytes, now: int) -> NegotiationStep[PeerT]:
        """Answer message_3 with message_4; the initiator is authenticated."""
        edhoc = cast("Responder[PeerT]", self._edhoc)
        message_4, peer = edhoc.message_3(body, now)
        return NegotiationStep(ConnectionState.OPEN, frame(Frame.HANDSHAKE, message_4), peer)

    def on_message_4(self, body: bytes, _: int) -> NegotiationStep[PeerT]:
        """The responder accepted this side and holds the same key."""
        cast("Initiator[PeerT]", self._edhoc).message_4(body)
        return NegotiationStep(ConnectionState.OPEN, peer=self._unconfirmed_peer)

    def on_error(self, body: bytes, _: int) -> NegotiationStep[PeerT]:
        """Fail, or retry where the peer only requires another suite."""
        self.peer_sent_error = True
        code, reason, suites = decode_error(body)
        edhoc = self._edhoc
        if code == UNKNOWN_CREDENTIAL:
            raise OwnCredentialUnknown(f"the peer refused the handshake: {reason}", _HINT_AGAIN)
        fresh = isinstance(edhoc, Initiator) and not edhoc.answered and not self._retried
        if code != WRONG_SUITE or not fresh:
            raise PeerRefused(f"the peer refused the handshake: {reason}", _HINT_REFUSED)
        self._edhoc = renewed = cast("Initiator[PeerT]", edhoc).after_wrong_suite(suites)
        self._retried, self.peer_sent_error = True, False
        return NegotiationStep(ConnectionState.WAIT_2, frame(Frame.HANDSHAKE, renewed.message_1()))

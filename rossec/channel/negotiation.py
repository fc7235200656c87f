"""What happens before records flow: the preamble, then the handshake message by message.

Each step takes what the peer sent and says which state follows and what to send back; the
connection does both. `Preamble` is for the bytes before the first frame, `Negotiation` holds the
rows of `states.TABLE` that concern the handshake.
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
    first_bytes,
    judge_answer,
    judge_caller,
    refusal,
)
from rossec.channel.records import ChannelLimits, Epochs, Frame, frame
from rossec.channel.session import Session
from rossec.channel.states import ConnectionState
from rossec.errors import OwnCredentialUnknown, PeerRefused, PlainPeer

_HINT_REFUSED: Final = "see the peer's log: it does not say why to one it does not trust"
_HINT_AGAIN: Final = "connect again: the whole certificate will be sent"
_HINT_PLAIN: Final = "the peer is a plain ROS node: give it an identity, or use another address"


class Preamble:
    """The bytes before the first frame, of either role; `accept` makes it a responder's."""

    def __init__(self, flavour: WireProtocol, accept: Collection[WireProtocol] | None) -> None:
        self.flavour = flavour
        self._reply = b"" if accept is not None else first_bytes(flavour)
        self._accept = accept
        self._drain = 0

    def take(self) -> bytes:
        """Return, once, what to send."""
        reply, self._reply = self._reply, b""
        return reply

    def feed(self, inbox: ReceiveBuffer, state: ConnectionState) -> ConnectionState:
        """Consume what belongs to the preamble; return the state that follows.

        Raises:
            PlainPeer: the peer speaks plain ROS; `take` may hold a readable refusal.
            ProtocolViolation: the peer speaks neither.
        """
        if state is ConnectionState.OPENING:
            prefix = bytes(inbox.unread()[:MAX_OPENING])
            if self._accept is None:
                return self._answer(inbox, judge_answer(prefix, self.flavour))
            state = self._call(inbox, judge_caller(prefix), self._accept)
        if state is ConnectionState.DRAINING:
            count = min(self._drain, len(inbox))
            inbox.consume(count)
            self._drain -= count
            if self._drain == 0:
                self._refuse()
        return state

    def _answer(self, inbox: ReceiveBuffer, length: int | None) -> ConnectionState:
        if length is None:
            return ConnectionState.OPENING
        inbox.consume(length)
        return ConnectionState.WAIT_2

    def _call(
        self, inbox: ReceiveBuffer, verdict: Verdict, accept: Collection[WireProtocol]
    ) -> ConnectionState:
        if verdict is None:
            return ConnectionState.OPENING
        self.flavour = verdict.flavour
        if isinstance(verdict, PlainCaller):
            self._drain = verdict.drain
            return ConnectionState.DRAINING
        if verdict.flavour not in accept:
            self._refuse()
        inbox.consume(verdict.consumed)
        self._reply = verdict.reply
        return ConnectionState.WAIT_1

    def _refuse(self) -> None:
        self._reply = refusal(self.flavour)
        raise PlainPeer(f"a plain {self.flavour.name} peer called and was refused", _HINT_PLAIN)


class NegotiationStep(NamedTuple, Generic[PeerT]):
    """What a message led to; `peer` once it is authenticated."""

    state: ConnectionState
    reply: bytes = b""
    peer: PeerT | None = None


class Negotiation(Generic[PeerT]):
    """The handshake of one connection, with at most one retry for another cipher suite."""

    def __init__(self, side: Initiator[PeerT] | Responder[PeerT]) -> None:
        self._side = side
        self._retried = False
        self._held: PeerT | None = None
        self.told = False  # the peer sent an error, which is never answered with one

    @classmethod
    def begin(cls, party: EdhocConfig[PeerT]) -> tuple["Negotiation[PeerT]", bytes]:
        """An initiator's, and the frame with its message_1."""
        side = Initiator(party)
        return cls(side), frame(Frame.HANDSHAKE, side.message_1())

    def session(self, limits: ChannelLimits, now: int) -> Session:
        """The record layer under the secret both sides now share."""
        side = self._side
        epochs = Epochs(side.suite, side.exporter, initiator=isinstance(side, Initiator))
        return Session(epochs, limits, now)

    def forget(self) -> None:
        """Drop the secrets."""
        self._side.forget()

    def on_message_1(self, body: bytes, _: int) -> NegotiationStep[PeerT]:
        """Answer message_1 with message_2, or once with the suites this side uses."""
        side = cast("Responder[PeerT]", self._side)
        try:
            return NegotiationStep(
                ConnectionState.WAIT_3, frame(Frame.HANDSHAKE, side.message_1(body))
            )
        except WrongSuite as error:
            if self._retried:
                raise
            self._retried = True
            text = encode_error(WRONG_SUITE, suites_item(error.suites))
            return NegotiationStep(ConnectionState.WAIT_1, frame(Frame.ERROR, text))

    def on_message_2(self, body: bytes, now: int) -> NegotiationStep[PeerT]:
        """Answer message_2 with message_3; the responder is authenticated."""
        side = cast("Initiator[PeerT]", self._side)
        message_3, peer = side.message_2(body, now)
        if side.brief:  # the responder may not know the certificate: nothing is sent before it says
            self._held, peer_now = peer, None
        else:
            peer_now = peer
        return NegotiationStep(ConnectionState.WAIT_4, frame(Frame.HANDSHAKE, message_3), peer_now)

    def on_message_3(self, body: bytes, now: int) -> NegotiationStep[PeerT]:
        """Answer message_3 with message_4; the initiator is authenticated."""
        side = cast("Responder[PeerT]", self._side)
        message_4, peer = side.message_3(body, now)
        return NegotiationStep(ConnectionState.OPEN, frame(Frame.HANDSHAKE, message_4), peer)

    def on_message_4(self, body: bytes, _: int) -> NegotiationStep[PeerT]:
        """The responder accepted this side and holds the same key."""
        cast("Initiator[PeerT]", self._side).message_4(body)
        return NegotiationStep(ConnectionState.OPEN, peer=self._held)

    def on_error(self, body: bytes, _: int) -> NegotiationStep[PeerT]:
        """Give up, or try again where the peer only wants another suite."""
        self.told = True
        code, reason, suites = decode_error(body)
        side = self._side
        if code == UNKNOWN_CREDENTIAL:
            raise OwnCredentialUnknown(f"the peer refused the handshake: {reason}", _HINT_AGAIN)
        fresh = isinstance(side, Initiator) and not side.answered and not self._retried
        if code != WRONG_SUITE or not fresh:
            raise PeerRefused(f"the peer refused the handshake: {reason}", _HINT_REFUSED)
        self._side = renewed = cast("Initiator[PeerT]", side).after_wrong_suite(suites)
        self._retried, self.told = True, False
        return NegotiationStep(ConnectionState.WAIT_2, frame(Frame.HANDSHAKE, renewed.message_1()))

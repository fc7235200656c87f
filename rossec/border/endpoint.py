"""The border router's side of CoAP: datagrams in, datagrams and events out. Pure.

Nothing is answered to a sender who proved nothing but a refusal without a reason, and that only if
it asked for an acknowledgement. What authenticated things send is handled at once; handshakes, and
attempts to derive a context anew, each have a budget of their own, so that a flood of one of them
keeps out neither the other nor the things that are there.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Final, Protocol

from aiocoap.numbers import codes

from ca.things.credentials import ThingKey
from rossec.border import rederivation, wire
from rossec.border.contexts import OscoreContext, RequestId, name_context, unprotected
from rossec.border.conversations import Conversation, Conversations
from rossec.border.handshakes import ID_SIZE, MAX_MESSAGE_3, Authenticated, Handshakes, StaticKey
from rossec.border.quotas import Unauthenticated
from rossec.border.rederivation import Challenges, border_context
from rossec.border.requests import Requests
from rossec.border.timers import Timers
from rossec.border.transmissions import Address, Send, Transmissions
from rossec.border.wire import Message
from rossec.errors import DatagramRefused, ThingError, ThingUnauthenticated

HANDSHAKE_PATH: Final = (".well-known", "edhoc")
REGISTRATION_PATH: Final = ("rd",)
HANDSHAKES: Final = 50.0  # begun a second, at most
DERIVATIONS: Final = 200.0  # contexts derived anew a second, at most
_MESSAGE_1: Final = b"\xf5"  # CBOR true, before message_1 (RFC 9528 appendix A.2)
_ALONE: Final = 0x18  # from here on a connection identifier of one octet is no integer


class Served(Protocol):
    """Which things are served."""

    def by_key(self, kid: bytes) -> tuple[str, ThingKey] | None:
        """The thing with a key that has this kid: its name, and the key."""

    def by_secret(self, kid: bytes) -> tuple[str, bytes] | None:
        """The thing with a secret that has this kid: its name, and the secret."""


class Events(Protocol):
    """What happens."""

    def registered(self, conversation: Conversation) -> None:
        """A thing is there: it is new, was restarted, or says again that it is there."""

    def left(self, name: str) -> None:
        """A thing takes its leave."""

    def ended(self, conversation: Conversation) -> None:
        """A conversation is over."""


@dataclass
class Counts:
    """What has happened so far."""

    datagrams: int = 0
    refused: int = 0
    over_budget: int = 0
    handshakes: int = 0
    derivations: int = 0
    octets: dict[str, int] = field(default_factory=dict)


class Endpoint:
    """One border router.

    Args:
        own: its key for things.
        served: which things it serves.
        events: what is told of them.
        send: sends a datagram.
        random: returns so many random octets.
        rand: a random number from 0 up to 1.
    """

    def __init__(
        self,
        own: StaticKey,
        served: Served,
        events: Events,
        send: Send,
        random: Callable[[int], bytes],
        rand: Callable[[], float],
    ) -> None:
        self._served = served
        self._events = events
        self._send = send
        self._random = random
        self.timers = Timers()
        self.conversations = Conversations(self._ended)
        self.counts = Counts()
        self._transmissions = Transmissions(send, self.timers, rand)
        self.requests = Requests(self._transmissions, self.timers, random)
        self._handshakes = Handshakes(own, self._find_key, self._is_taken, random)
        self._challenges = Challenges(random(16))
        self._handshake_budget = Unauthenticated(HANDSHAKES)
        self._derivation_budget = Unauthenticated(DERIVATIONS)
        self._decoy = OscoreContext(random(16), b"", b"\0", b"\1")

    def receive(self, data: bytes, address: Address, now: float) -> None:
        """Take a datagram; whatever is wrong with it ends here."""
        self.counts.datagrams += 1
        try:
            message = wire.read(data)
            self._take(message, address, now)
        except ThingError:
            self.counts.refused += 1

    def run_timers(self, now: float) -> None:
        """Do what is due."""
        self.timers.run(now)

    def _take(self, message: Message, address: Address, now: float) -> None:
        mid = wire.number_of(message)
        if message.mtype == wire.RST:
            return  # as if it was lost: see `transmissions`
        if wire.is_empty(message):
            if message.mtype == wire.ACK:
                self._transmissions.acknowledge(address, mid)
            elif message.mtype == wire.CON:  # a ping
                self._send(wire.empty(wire.RST, mid), address)
        elif message.code.is_response():
            self._take_response(message, address, now)
        elif message.code.is_request() and message.mtype in {wire.CON, wire.NON}:
            self._take_request(message, address, now)

    def _take_response(self, message: Message, address: Address, now: float) -> None:
        exchange = self.requests.find(message, address)
        if exchange is None:
            if message.mtype == wire.CON:
                self._send(wire.empty(wire.RST, wire.number_of(message)), address)
            raise DatagramRefused("a response that nobody waits for")
        talk = exchange.conversation
        if exchange.request.observe and talk.quota.is_spent(now):
            raise DatagramRefused("a thing that sends far more than its rate")
        talk.seen = now
        if message.mtype == wire.CON:
            self._send(wire.empty(wire.ACK, wire.number_of(message)), address)
        self.requests.take(exchange, message, now)

    def _take_request(self, message: Message, address: Address, now: float) -> None:
        try:
            if message.opt.oscore is not None:
                self._take_protected(message, address, now)
            elif message.opt.uri_path == HANDSHAKE_PATH and message.code == codes.POST:
                self._take_handshake(message, address, now)
            else:
                raise DatagramRefused("a request without protection")
        except ThingError:
            if message.mtype == wire.CON:
                self._answer(message, wire.refusal(codes.UNAUTHORIZED), address)
            raise

    # --- EDHOC (RFC 9528 appendix A.2)

    def _take_handshake(self, message: Message, address: Address, now: float) -> None:
        payload = bytes(message.payload)
        if payload[:1] != _MESSAGE_1:
            own_id, message_3 = _split_message_3(payload)
            found = self._finish(own_id, message_3, address, now)
            self._answer(message, Message(code=codes.CHANGED, payload=found.message_4), address)
            return
        message_2 = self._handshakes.repeated(payload[1:], address)
        if message_2 is None:
            self._spend(self._handshake_budget, address, now)
            message_2 = self._handshakes.begin(payload[1:], address, now)
            self._count(message_1=len(payload) - 1, message_2=len(message_2))
        self._answer(message, Message(code=codes.CHANGED, payload=message_2), address)

    def _finish(
        self, own_id: bytes, message_3: bytes, address: Address, now: float
    ) -> Authenticated:
        found = self._handshakes.finish(own_id, message_3, now)
        served = self._served.by_key(found.key.kid)
        if served is None:
            raise ThingUnauthenticated("a thing that is not served any more")
        self._count(message_3=len(message_3))
        self.counts.handshakes += 1
        conversation = Conversation(served[0], found.context, address, self._number())
        conversation.seen = now
        self.conversations.add(conversation)
        return found

    # --- protected requests

    def _take_protected(self, message: Message, address: Address, now: float) -> None:
        kid, kid_context = unprotected(message)
        conversation = self.conversations.find(kid)
        if conversation is not None and rederivation.is_in(conversation.context, kid_context):
            known = conversation.remembered(address, wire.number_of(message))
            if known is not None:
                self._send(known, address)
                return
        if message.opt.edhoc:
            message_3, rest = _split_combined(bytes(message.payload))
            self._finish(kid, message_3, address, now)
            message.payload, message.opt.edhoc = rest, False
            conversation = self.conversations.find(kid)
        if kid_context is not None:
            self._take_derived(message, kid, kid_context, address, now)
            return
        if conversation is not None and conversation.address == address:
            self._check_rate(conversation, now)
        if conversation is None:
            self._decoy.recipient_id = kid  # else it is refused before it is decrypted
            self._decoy.open(message)
            raise DatagramRefused("no context with this kid")
        opened, identifier = conversation.context.open(message)
        self._serve(conversation, message, opened, identifier, address, now)

    def _take_derived(
        self, message: Message, kid: bytes, kid_context: bytes, address: Address, now: float
    ) -> None:
        """A request that names the context it is in (RFC 8613 appendix B.2)."""
        value = rederivation.unwrapped(kid_context)
        current = self.conversations.find(kid)
        if current is not None and current.context.id_context == value:
            if current.address == address:
                self._check_rate(current, now)
            opened, identifier = current.context.open(message)
            self._serve(current, message, opened, identifier, address, now)
            return
        self._spend(self._derivation_budget, address, now)
        served = self._served.by_secret(kid)
        name, secret = ("", b"\0" * 16) if served is None else served
        context = border_context(secret, kid, value)
        opened, identifier = context.open(message)
        if served is None:
            raise DatagramRefused("no thing with this kid")
        if not self._challenges.take(kid, value, now):
            self._challenge(message, value, secret, kid, identifier, address, now)
            return
        self.counts.derivations += 1
        conversation = Conversation(name, context, address, self._number())
        self.conversations.add(conversation)
        self._serve(conversation, message, opened, identifier, address, now)

    def _challenge(
        self, message: Message, value: bytes, secret: bytes, kid: bytes, identifier: RequestId,
        address: Address, now: float,
    ) -> None:  # fmt: skip
        """Answer the first request of a derivation, which may be an old one that is repeated."""
        value_2 = self._challenges.make(kid, now, self._random(2))
        context = border_context(secret, kid, value_2 + value)
        sealed, _ = context.seal(Message(code=codes.UNAUTHORIZED), identifier)
        name_context(sealed, rederivation.wrapped(value_2))
        self._answer(message, sealed, address)

    def _serve(
        self,
        conversation: Conversation,
        message: Message,
        opened: Message,
        identifier: RequestId,
        address: Address,
        now: float,
    ) -> None:
        """Carry out a request of a thing, and answer it."""
        conversation.seen = now
        self.conversations.used(conversation, address)
        is_registration = opened.opt.uri_path == REGISTRATION_PATH
        if not conversation.quota.take(now):
            response = Message(code=codes.TOO_MANY_REQUESTS)
        elif is_registration and opened.code == codes.POST:
            response = Message(code=codes.CHANGED)
        elif is_registration and opened.code == codes.DELETE:
            response = Message(code=codes.DELETED)
        else:
            response = Message(code=codes.NOT_FOUND)
        code = response.code
        sealed, _ = conversation.context.seal(response, identifier)
        answer = self._answer(message, sealed, address, conversation.new_mid())
        conversation.remember(address, wire.number_of(message), answer)
        if code == codes.CHANGED:
            self._events.registered(conversation)
        elif code == codes.DELETED:
            self._events.left(conversation.name)

    # --- what these have in common

    def _check_rate(self, conversation: Conversation, now: float) -> None:
        if conversation.quota.is_spent(now):
            raise DatagramRefused("a thing that sends far more than its rate")

    def _number(self) -> int:
        return int.from_bytes(self._random(2))

    def _answer(
        self, request: Message, response: Message, address: Address, mid: int | None = None
    ) -> bytes:
        mid = self._number() if mid is None else mid  # a stranger learns nothing of others
        data = wire.write(wire.answer(request, response, mid))
        self._send(data, address)
        return data

    def _spend(self, budget: Unauthenticated, address: Address, now: float) -> None:
        if not budget.take(str(address[0]), int(address[1]), now):
            self.counts.over_budget += 1
            raise ThingUnauthenticated("more attempts than are looked at")

    def _find_key(self, kid: bytes) -> ThingKey | None:
        found = self._served.by_key(kid)
        return None if found is None else found[1]

    def _is_taken(self, own_id: bytes) -> bool:
        in_use = self.conversations.find(own_id) is not None
        return in_use or self._served.by_secret(own_id) is not None

    def _ended(self, conversation: Conversation) -> None:
        self.requests.end(conversation)
        self._events.ended(conversation)

    def _count(self, **octets: int) -> None:
        self.counts.octets.update(octets)


def _split_message_3(payload: bytes) -> tuple[bytes, bytes]:
    """C_R and message_3, as they are sent without a request.

    Raises:
        ThingUnauthenticated: no C_R of the length that is given out here.
    """
    head = bytes((0x40 | ID_SIZE,))
    if payload[:1] != head or len(payload) <= 1 + ID_SIZE:
        raise ThingUnauthenticated("a message_3 without a connection identifier")
    return payload[1 : 1 + ID_SIZE], payload[1 + ID_SIZE :]


def _split_combined(payload: bytes) -> tuple[bytes, bytes]:
    """message_3, and the protected request that came with it (RFC 9668 section 3.3).

    Raises:
        ThingUnauthenticated: it does not begin with a byte string.
    """
    size = payload[1] if payload[:1] == b"\x58" and len(payload) > 1 else -1
    begin, length = (2, size) if size >= 0 else (1, payload[0] - 0x40 if payload else -1)
    if not 0 < length <= MAX_MESSAGE_3 or (begin == 1 and length >= _ALONE):
        raise ThingUnauthenticated("a combined request without message_3")
    return payload[: begin + length], payload[begin + length :]

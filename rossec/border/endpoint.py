"""The border router's side of CoAP: datagrams in, datagrams and events out. Pure.

What authenticated things send is handled at once; handshakes, and attempts to derive a context anew,
each have a budget of their own.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Final, NamedTuple, Protocol

from aiocoap import Message
from aiocoap.numbers import codes
from aiocoap.numbers.codes import Code
from aiocoap.optiontypes import BlockOption

from ca.things import ThingKey
from rossec.border import messages
from rossec.border.conversations import MAX_BLOCK, MAX_BODY, Conversation, Conversations, Unauthenticated
from rossec.border.handshakes import ID_SIZE, MAX_MESSAGE_3, HandshakeCompleted, Handshakes, StaticKey
from rossec.errors import DatagramRefused, ThingError, ThingUnreachable

DEADLINE: Final = 95.0  # seconds for one message and its answer; repeated for 62 to 93
RETRY: Final = 0.25  # seconds until a request is sent again that got an unprotected answer
RETRIES: Final = 7  # over half a minute: what tells the thing its context may be lost a few times
_NONE: Final = -2  # lower than the sequence number of any answer
_SZX: Final = 6  # blocks of 1024 octets
HANDSHAKE_PATH: Final = (".well-known", "edhoc")
REGISTRATION_PATH: Final = ("rd",)
HANDSHAKES: Final = 50.0  # begun a second, at most
DERIVATIONS: Final = 200.0  # contexts derived anew a second, at most
_MESSAGE_1: Final = b"\xf5"  # CBOR true, before message_1 (RFC 9528 appendix A.2)
_ALONE: Final = 0x18  # from here on a connection identifier of one octet is no integer


class CoapAnswer(NamedTuple):
    code: Code
    format: int | None  # None: not said
    body: bytes


OnAnswer = Callable[[CoapAnswer | ThingUnreachable], None]


class CoapRequest(NamedTuple):
    code: Code
    path: tuple[str, ...]
    body: bytes = b""
    format: int | None = None
    observe: bool = False


@dataclass(slots=True, eq=False)
class PendingRequest:
    conversation: Conversation
    request: CoapRequest
    on_answer: OnAnswer
    token: bytes = b""
    identifier: messages.RequestId = None
    mid: int = 0
    sent: int = 0  # blocks of the body that were acknowledged
    received: bytes | None = None  # blocks of the answer before this one
    tag: bytes | None = None  # ETag of these blocks: all are of one state
    newest: int = _NONE  # sequence number of the newest answer to an observation
    deadline: int = -1
    retry: int = -1
    tries: int = 0


class Requests:
    """Requests to things that are under way: blocks (RFC 7959), observations (RFC 7641).

    Answers are matched by token, by the address of the thing and by OSCORE's binding to the request.
    """

    def __init__(
        self, transmissions: messages.Transmissions, timers: messages.Timers, random: Callable[[int], bytes]
    ) -> None:
        self._transmissions, self._timers, self._random = transmissions, timers, random
        self._exchanges: dict[bytes, PendingRequest] = {}

    def __len__(self) -> int:
        return len(self._exchanges)

    def start(
        self, conversation: Conversation, request: CoapRequest, on_answer: OnAnswer, now: float
    ) -> PendingRequest:
        exchange = PendingRequest(conversation, request, on_answer)
        self._send(exchange, now)
        return exchange

    def cancel(self, exchange: PendingRequest) -> None:
        self._exchanges.pop(exchange.token, None)
        exchange.conversation.tokens.discard(exchange.token)
        self._timers.cancel(exchange.deadline)
        self._timers.cancel(exchange.retry)
        exchange.retry = -1
        self._transmissions.acknowledge(exchange.conversation.address, exchange.mid)

    def end(self, conversation: Conversation) -> None:
        for token in tuple(conversation.tokens):
            self._fail(self._exchanges[token], "its conversation has ended")

    def find(self, message: Message, address: Any) -> PendingRequest | None:
        found = self._exchanges.get(bytes(message.token))
        if found is None or found.conversation.address != address:
            return None
        return found

    def take(self, exchange: PendingRequest, message: Message, now: float) -> None:
        may_ask_again = exchange.retry < 0 and exchange.newest == _NONE and exchange.tries < RETRIES
        if message.opt.oscore is None and may_ask_again:
            # A thing that just registered may not know its new context everywhere.
            # Nobody has vouched for such an answer, so it ends nothing.
            pause = RETRY * 2**exchange.tries
            exchange.tries += 1

            def ask_again(at: float) -> None:
                self.cancel(exchange)
                self._send(exchange, at)

            exchange.retry = self._timers.at(now + pause, ask_again)
        # RFC 8613 section 8.4: verified by the context and the request it answers; nothing counts before.
        opened, _ = exchange.conversation.context.open(message, exchange.identifier)
        self._transmissions.acknowledge(exchange.conversation.address, exchange.mid)
        # RFC 8613 section 7.4.1: a notification counts if its sequence number is higher than all before,
        # and so does any answer to an observation: no tag covers the option that says it is one.
        if exchange.request.observe:
            number = messages.partial_iv(message)
            if number <= exchange.newest:
                raise DatagramRefused("a notification that is older than the last one")
            exchange.newest = number
        self._timers.cancel(exchange.deadline)
        self._timers.cancel(exchange.retry)
        if exchange.request.observe and opened.opt.observe is not None:
            self._notified(exchange, opened, now)
        else:
            self.cancel(exchange)
            self._answered(exchange, opened, now)

    def _notified(self, exchange: PendingRequest, opened: Message, now: float) -> None:
        if not exchange.conversation.quota.take(now):
            return
        block = opened.opt.block2
        if block is None or not block.more:
            exchange.on_answer(_answer(opened, bytes(opened.payload)))
            return

        def assembled(answer: CoapAnswer | ThingUnreachable) -> None:
            if isinstance(answer, CoapAnswer):  # else this state is lost; the observation goes on
                exchange.on_answer(answer)

        path = exchange.request.path
        rest = PendingRequest(exchange.conversation, CoapRequest(codes.GET, path), assembled)
        self._next_block(rest, opened, now)

    def _answered(self, exchange: PendingRequest, opened: Message, now: float) -> None:
        # RFC 7959 section 2.5: the block was taken, the next one follows.
        if opened.code == codes.CONTINUE:
            exchange.sent += 1
            if exchange.sent * MAX_BLOCK >= len(exchange.request.body):
                self._fail(exchange, "it asks for more blocks than there are")
            else:
                self._send(exchange, now)
            return
        # RFC 7959 section 2.4: more of the answer is to be fetched, or this was the last of it.
        block = opened.opt.block2
        if opened.code.is_successful() and block is not None and block.more:
            self._next_block(exchange, opened, now)
            return
        before = exchange.received or b""
        if block is not None and not _continues(exchange, opened):
            self._fail(exchange, "the blocks of its answer do not fit together")
            return
        exchange.on_answer(_answer(opened, before + bytes(opened.payload)))

    def _next_block(self, exchange: PendingRequest, opened: Message, now: float) -> None:
        block, before = opened.opt.block2, exchange.received or b""
        body = before + bytes(opened.payload)
        fits = _continues(exchange, opened) and len(opened.payload) == block.size <= MAX_BLOCK
        if not fits or len(body) > MAX_BODY:
            self._fail(exchange, "its answer is too long, or its blocks do not fit together")
            return
        exchange.received, exchange.tag = body, opened.opt.etag
        number = len(body) // block.size
        self._send(exchange, now, BlockOption.BlockwiseTuple(number, False, block.size_exponent))

    def _send(self, exchange: PendingRequest, now: float, wanted: Any = None) -> None:
        request, conversation = exchange.request, exchange.conversation
        message = Message(code=request.code, uri_path=request.path)
        message.opt.observe = messages.OBSERVE if request.observe and wanted is None else None
        message.opt.block2 = wanted
        exchange.newest = _NONE
        if request.body:
            message.opt.content_format = request.format
            if wanted is None:
                begin, end = exchange.sent * MAX_BLOCK, (exchange.sent + 1) * MAX_BLOCK
                message.payload = request.body[begin:end]
                if len(request.body) > MAX_BLOCK:
                    more = end < len(request.body)
                    message.opt.block1 = BlockOption.BlockwiseTuple(exchange.sent, more, _SZX)
        # A token is random and used once (RFC 7252 section 5.3.1): a late answer of before fits none.
        sealed, exchange.identifier = conversation.context.seal(message)
        while (token := self._random(messages.TOKEN_SIZE)) in self._exchanges:
            pass
        exchange.token = sealed.token = token
        exchange.mid = sealed.mid = conversation.new_mid()
        sealed.mtype = messages.CON
        self._exchanges[exchange.token] = exchange
        conversation.tokens.add(exchange.token)
        exchange.deadline = self._timers.at(
            now + DEADLINE, lambda _: self._fail(exchange, "it did not answer in time")
        )
        self._transmissions.send(
            messages.write(sealed),
            exchange.mid,
            conversation.address,
            now,
            lambda: self._fail(exchange, "it is out of reach"),
        )

    def _fail(self, exchange: PendingRequest, reason: str) -> None:
        self.cancel(exchange)
        exchange.on_answer(ThingUnreachable(f"{exchange.conversation.name}: {reason}"))


def _continues(exchange: PendingRequest, opened: Message) -> bool:
    # Whether a block is the next one, and of the same state (RFC 7959 section 2.4).
    before = exchange.received
    if before is not None and opened.opt.etag != exchange.tag:
        return False
    return bool(opened.opt.block2.start == len(before or b""))


def _answer(opened: Message, body: bytes) -> CoapAnswer:
    form = opened.opt.content_format
    return CoapAnswer(opened.code, None if form is None else int(form), body)


class Served(Protocol):
    def by_key(self, kid: bytes) -> tuple[str, ThingKey] | None: ...
    def by_secret(self, kid: bytes) -> tuple[str, bytes] | None: ...  # the name, and the secret


class Events(Protocol):
    def registered(self, conversation: Conversation) -> None: ...
    def left(self, name: str) -> None: ...
    def ended(self, conversation: Conversation) -> None: ...


@dataclass
class EndpointCounts:
    datagrams: int = 0
    refused: int = 0
    over_budget: int = 0
    handshakes: int = 0
    derivations: int = 0
    octets: dict[str, int] = field(default_factory=dict)


class CoapEndpoint:
    """One border router; `rand`: a random number from 0 up to 1."""

    def __init__(
        self,
        own: StaticKey,
        served: Served,
        events: Events,
        send: messages.Send,
        random: Callable[[int], bytes],
        rand: Callable[[], float],
    ) -> None:
        self._served, self._events, self._send = served, events, send
        self._random = random
        self.timers = messages.Timers()
        self.conversations = Conversations(self._ended)
        self.counts = EndpointCounts()
        self._transmissions = messages.Transmissions(send, self.timers, rand)
        self.requests = Requests(self._transmissions, self.timers, random)

        def find_key(kid: bytes) -> ThingKey | None:
            found = served.by_key(kid)
            return None if found is None else found[1]

        def is_taken(own_id: bytes) -> bool:
            return self.conversations.find(own_id) is not None or served.by_secret(own_id) is not None

        self._handshakes = Handshakes(own, find_key, is_taken, random)
        self._challenges = messages.ContextChallenges(random(16))
        self._handshake_budget = Unauthenticated(HANDSHAKES)
        self._derivation_budget = Unauthenticated(DERIVATIONS)
        self._decoy = messages.OscoreContext(random(16), b"", b"\0", b"\1")

    def receive(self, data: bytes, address: messages.Address, now: float) -> None:
        """RFC 7252 section 4: what a datagram is by its type and code."""
        self.counts.datagrams += 1
        try:
            message = messages.read(data)
            mid, kind = messages.number_of(message), message.mtype
            if kind == messages.RST:  # 4.2: it is not protected, so it counts as lost (see `Transmissions`)
                return
            if messages.is_empty(message):
                if kind == messages.ACK:
                    self._transmissions.acknowledge(address, mid)
                elif kind == messages.CON:  # a ping: rejected
                    self._send(messages.empty(messages.RST, mid), address)
            elif message.code.is_response():
                self._take_response(message, address, now)
            elif message.code.is_request() and kind in {messages.CON, messages.NON}:
                self._take_request(message, address, now)
        except ThingError:
            self.counts.refused += 1

    def _take_response(self, message: Message, address: messages.Address, now: float) -> None:
        # RFC 7252 section 5.3.2: matched by token and address, or rejected.
        exchange = self.requests.find(message, address)
        if exchange is None:
            if message.mtype == messages.CON:
                self._send(messages.empty(messages.RST, messages.number_of(message)), address)
            raise DatagramRefused("a response that nobody waits for")
        talk = exchange.conversation
        if exchange.request.observe and talk.quota.is_spent(now):
            raise DatagramRefused("a thing that sends far more than its rate")
        talk.seen = now
        if message.mtype == messages.CON:  # 5.2.2: a separate answer; acknowledged before it is decrypted
            self._send(messages.empty(messages.ACK, messages.number_of(message)), address)
        self.requests.take(exchange, message, now)

    def _take_request(self, message: Message, address: messages.Address, now: float) -> None:
        try:
            if message.opt.oscore is not None:
                self._take_protected(message, address, now)
            elif message.opt.uri_path == HANDSHAKE_PATH and message.code == codes.POST:
                self._take_handshake(message, address, now)
            else:
                raise DatagramRefused("a request without protection")
        except ThingError:
            # The same for every reason, and nothing to what needs no acknowledgement: a stranger learns
            # nothing, and forged addresses get no more than they sent.
            if message.mtype == messages.CON:
                self._answer(message, Message(code=codes.UNAUTHORIZED), address)
            raise

    # --- EDHOC (RFC 9528 appendix A.2)

    def _take_handshake(self, message: Message, address: messages.Address, now: float) -> None:
        payload = bytes(message.payload)
        if payload[:1] != _MESSAGE_1:
            # A.2.1: C_R goes before message_3, as a byte string of three octets.
            head = bytes((0x40 | ID_SIZE,))
            if payload[:1] != head or len(payload) <= 1 + ID_SIZE:
                raise ThingError("a message_3 without a connection identifier")
            own_id, message_3 = payload[1 : 1 + ID_SIZE], payload[1 + ID_SIZE :]
            found = self._finish(own_id, message_3, address, now)
            self._answer(message, Message(code=codes.CHANGED, payload=found.message_4), address)
            return
        # A repetition gets the answer of before, and costs no budget; a new one is paid for first.
        message_2 = self._handshakes.repeated(payload[1:], address)
        if message_2 is None:
            self._spend(self._handshake_budget, address, now)
            message_2 = self._handshakes.begin(payload[1:], address, now)
            self.counts.octets.update(message_1=len(payload) - 1, message_2=len(message_2))
        self._answer(message, Message(code=codes.CHANGED, payload=message_2), address)

    def _finish(
        self, own_id: bytes, message_3: bytes, address: messages.Address, now: float
    ) -> HandshakeCompleted:
        found = self._handshakes.finish(own_id, message_3, now)
        served = self._served.by_key(found.key.kid)
        if served is None:  # revoked while the handshake was under way
            raise ThingError("a thing that is not served any more")
        self.counts.octets["message_3"] = len(message_3)
        self.counts.handshakes += 1
        conversation = Conversation(served[0], found.context, address, self._number())
        conversation.seen = now
        self.conversations.add(conversation)
        return found

    # --- protected requests

    def _take_protected(self, message: Message, address: messages.Address, now: float) -> None:
        # 1. RFC 8613 section 8.2, step 2: the context, by what the option says.
        kid, kid_context = messages.unprotected(message)
        conversation = self.conversations.find(kid)
        # 2. RFC 7252 section 4.5: a repetition gets the answer of before, and is not carried out again.
        if conversation is not None and messages.is_in(conversation.context, kid_context):
            known = conversation.remembered(address, messages.number_of(message))
            if known is not None:
                self._send(known, address)
                return
        # 3. RFC 9668 section 3.3.1: message_3 comes first in the payload, and makes the context of the rest.
        if message.opt.edhoc:
            message_3, rest = _split_combined(bytes(message.payload))
            self._finish(kid, message_3, address, now)
            message.payload, message.opt.edhoc = rest, False
            conversation = self.conversations.find(kid)
        # 4. RFC 8613 appendix B.2: a context that is named is current, or is derived.
        if kid_context is not None:
            self._take_derived(message, kid, kid_context, address, now)
            return
        # 5. RFC 8613 section 8.2, steps 3 to 7. An unknown kid costs the work of a known one: who tries kids
        #    cannot tell by the time which ones are in use.
        if conversation is not None and conversation.address == address:
            self._check_rate(conversation, now)
        if conversation is None:
            self._decoy.recipient_id = kid  # else it is refused before it is decrypted
            self._decoy.open(message)
            raise DatagramRefused("no context with this kid")
        opened, identifier = conversation.context.open(message)
        self._serve(conversation, message, opened, identifier, address, now)

    def _take_derived(
        self, message: Message, kid: bytes, kid_context: bytes, address: messages.Address, now: float
    ) -> None:
        # A request that names the context it is in: RFC 8613 appendix B.2, as steps in docs/spec/border.md.
        value = messages.unwrapped(kid_context)
        current = self.conversations.find(kid)
        if current is not None and current.context.id_context == value:
            if current.address == address:
                self._check_rate(current, now)
            opened, identifier = current.context.open(message)
            self._serve(current, message, opened, identifier, address, now)
            return
        # A budget of its own: a flood of these keeps out no handshakes, nor the things that are there.
        self._spend(self._derivation_budget, address, now)
        served = self._served.by_secret(kid)
        name, secret = ("", b"\0" * 16) if served is None else served
        context = messages.border_context(secret, kid, value)
        opened, identifier = context.open(message)
        if served is None:
            raise DatagramRefused("no thing with this kid")
        # Steps 1 and 2: not of an R2 that is recent and new, so it is not carried out but answered with one.
        if not self._challenges.take(kid, value, now):
            value_2 = self._challenges.make(kid, now, self._random(2))
            challenge = messages.border_context(secret, kid, value_2 + value)
            sealed, _ = challenge.seal(Message(code=codes.UNAUTHORIZED), identifier)
            messages.name_context(sealed, messages.wrapped(value_2))
            self._answer(message, sealed, address)
            return
        # Step 3: from now on both sides use this context.
        self.counts.derivations += 1
        conversation = Conversation(name, context, address, self._number())
        self.conversations.add(conversation)
        self._serve(conversation, message, opened, identifier, address, now)

    def _serve(
        self,
        conversation: Conversation,
        message: Message,
        opened: Message,
        identifier: messages.RequestId,
        address: messages.Address,
        now: float,
    ) -> None:
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
        code = response.code  # sealing changes it
        sealed, _ = conversation.context.seal(response, identifier)
        answer = self._answer(message, sealed, address, conversation.new_mid())
        conversation.remember(address, messages.number_of(message), answer)
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
        self, request: Message, response: Message, address: messages.Address, mid: int | None = None
    ) -> bytes:
        mid = self._number() if mid is None else mid  # a stranger learns nothing of others
        data = messages.write(messages.answer(request, response, mid))
        self._send(data, address)
        return data

    def _spend(self, budget: Unauthenticated, address: messages.Address, now: float) -> None:
        if not budget.take(str(address[0]), int(address[1]), now):
            self.counts.over_budget += 1
            raise ThingError("more attempts than are looked at")

    def _ended(self, conversation: Conversation) -> None:
        self.requests.end(conversation)
        self._events.ended(conversation)


def _split_combined(payload: bytes) -> tuple[bytes, bytes]:
    # message_3, and the protected request that came with it (RFC 9668 section 3.3): one byte string, with its
    # length in the first octet or in the second.
    size = payload[1] if payload[:1] == b"\x58" and len(payload) > 1 else -1
    begin, length = (2, size) if size >= 0 else (1, payload[0] - 0x40 if payload else -1)
    if not 0 < length <= MAX_MESSAGE_3 or (begin == 1 and length >= _ALONE):
        raise ThingError("a combined request without message_3")
    return payload[: begin + length], payload[begin + length :]

"""Requests of the border router to things: blocks (RFC 7959), observations (RFC 7641). Pure.

Answers are matched by token, by the address of the thing and by OSCORE's binding to the request. An
answer to an observation counts only if its sequence number is higher than that of the one before,
whether or not it says that it is a notification: no tag covers that option.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final, NamedTuple

from aiocoap.numbers import codes
from aiocoap.numbers.codes import Code
from aiocoap.optiontypes import BlockOption

from rossec.border import wire
from rossec.border.contexts import RequestId, partial_iv
from rossec.border.conversations import Conversation
from rossec.border.quotas import MAX_BLOCK, MAX_BODY
from rossec.border.timers import Timers
from rossec.border.transmissions import Transmissions
from rossec.border.wire import Message
from rossec.errors import DatagramRefused, ThingUnreachable

DEADLINE: Final = 95.0  # seconds for one message and its answer; repeated for 62 to 93
RETRY: Final = 0.25  # seconds until a request is sent again that got an unprotected answer
RETRIES: Final = 7  # over half a minute: what tells the thing its context may be lost a few times
_NONE: Final = -2  # lower than the sequence number of any answer
_SZX: Final = 6  # blocks of 1024 octets


class Answer(NamedTuple):
    """What a thing answered: its code, the content format (None: not said), the body."""

    code: Code
    format: int | None
    body: bytes


OnAnswer = Callable[[Answer | ThingUnreachable], None]


@dataclass(frozen=True, slots=True)
class Request:
    """What is asked of a thing."""

    code: Code
    path: tuple[str, ...]
    body: bytes = b""
    format: int | None = None
    observe: bool = False


class PendingRequest:
    """One request until its last answer; an observation until it is cancelled."""

    __slots__ = (
        "conversation", "deadline", "identifier", "mid", "newest", "on_answer", "received",
        "request", "retry", "sent", "tag", "token", "tries",
    )  # fmt: skip

    def __init__(self, conversation: Conversation, request: Request, on_answer: OnAnswer) -> None:
        self.conversation = conversation
        self.request = request
        self.on_answer = on_answer
        self.token = b""
        self.identifier: RequestId = None
        self.mid = 0
        self.sent = 0  # blocks of the body that were acknowledged
        self.received: bytes | None = None  # blocks of the answer before this one
        self.tag: bytes | None = None  # ETag of these blocks: all are of one state
        self.newest = _NONE  # sequence number of the newest answer to an observation
        self.deadline = self.retry = -1
        self.tries = 0


class Requests:
    """All requests under way.

    Args:
        transmissions: sends, and repeats.
        timers: of all things.
        random: returns so many random octets.
    """

    def __init__(
        self, transmissions: Transmissions, timers: Timers, random: Callable[[int], bytes]
    ) -> None:
        self._transmissions = transmissions
        self._timers = timers
        self._random = random
        self._exchanges: dict[bytes, PendingRequest] = {}

    def __len__(self) -> int:
        return len(self._exchanges)

    def start(
        self, conversation: Conversation, request: Request, on_answer: OnAnswer, now: float
    ) -> PendingRequest:
        """Send a request; `on_answer` is called once, of an observation with each state."""
        exchange = PendingRequest(conversation, request, on_answer)
        self._send(exchange, now)
        return exchange

    def cancel(self, exchange: PendingRequest) -> None:
        """Expect nothing more; the next notification is answered by a reset."""
        self._exchanges.pop(exchange.token, None)
        exchange.conversation.tokens.discard(exchange.token)
        self._timers.cancel(exchange.deadline)
        self._timers.cancel(exchange.retry)
        exchange.retry = -1
        self._transmissions.acknowledge(exchange.conversation.address, exchange.mid)

    def end(self, conversation: Conversation) -> None:
        """Fail everything that was asked in a conversation that is over."""
        for token in tuple(conversation.tokens):
            self._fail(self._exchanges[token], "its conversation has ended")

    def find(self, message: Message, address: Any) -> PendingRequest | None:
        """The request that a response is for."""
        found = self._exchanges.get(bytes(message.token))
        if found is None or found.conversation.address != address:
            return None
        return found

    def take(self, exchange: PendingRequest, message: Message, now: float) -> None:
        """Take a response.

        Raises:
            DatagramRefused: it is not of the thing, or an old notification.
        """
        if message.opt.oscore is None:
            self._unprotected(exchange, now)
        opened, _ = exchange.conversation.context.open(message, exchange.identifier)
        self._transmissions.acknowledge(exchange.conversation.address, exchange.mid)
        if exchange.request.observe:
            number = partial_iv(message)
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

    def _unprotected(self, exchange: PendingRequest, now: float) -> None:
        """Ask again: a thing that just registered may not know its new context everywhere.

        Nobody has vouched for such an answer, so it ends nothing.
        """
        if exchange.retry < 0 and exchange.newest == _NONE and exchange.tries < RETRIES:
            pause = RETRY * 2**exchange.tries
            exchange.tries += 1
            exchange.retry = self._timers.at(now + pause, lambda at: self._ask_again(exchange, at))

    def _ask_again(self, exchange: PendingRequest, now: float) -> None:
        self.cancel(exchange)
        self._send(exchange, now)

    def _notified(self, exchange: PendingRequest, opened: Message, now: float) -> None:
        if not exchange.conversation.quota.take(now):
            return
        block = opened.opt.block2
        if block is None or not block.more:
            exchange.on_answer(_answer(opened, bytes(opened.payload)))
            return

        def assembled(answer: Answer | ThingUnreachable) -> None:
            if isinstance(answer, Answer):  # else this state is lost; the observation goes on
                exchange.on_answer(answer)

        path = exchange.request.path
        rest = PendingRequest(exchange.conversation, Request(codes.GET, path), assembled)
        self._next_block(rest, opened, now)

    def _answered(self, exchange: PendingRequest, opened: Message, now: float) -> None:
        if opened.code == codes.CONTINUE:
            self._acknowledged_block(exchange, now)
            return
        block = opened.opt.block2
        if opened.code.is_successful() and block is not None and block.more:
            self._next_block(exchange, opened, now)
            return
        before = exchange.received or b""
        if block is not None and not _continues(exchange, opened):
            self._fail(exchange, "the blocks of its answer do not fit together")
            return
        exchange.on_answer(_answer(opened, before + bytes(opened.payload)))

    def _acknowledged_block(self, exchange: PendingRequest, now: float) -> None:
        exchange.sent += 1
        if exchange.sent * MAX_BLOCK >= len(exchange.request.body):
            self._fail(exchange, "it asks for more blocks than there are")
            return
        self._send(exchange, now)

    def _next_block(self, exchange: PendingRequest, opened: Message, now: float) -> None:
        """Ask for the next block of an answer."""
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
        message.opt.observe = wire.OBSERVE if request.observe and wanted is None else None
        message.opt.block2 = wanted
        exchange.newest = _NONE
        if request.body:
            message.opt.content_format = request.format
            if wanted is None:
                _put_block(message, request, exchange.sent)
        sealed, exchange.identifier = conversation.context.seal(message)
        exchange.token = sealed.token = self._new_token()
        exchange.mid = sealed.mid = conversation.new_mid()
        sealed.mtype = wire.CON
        self._exchanges[exchange.token] = exchange
        conversation.tokens.add(exchange.token)
        exchange.deadline = self._timers.at(
            now + DEADLINE, lambda _: self._fail(exchange, "it did not answer in time")
        )
        self._transmissions.send(
            wire.write(sealed), exchange.mid, conversation.address, now,
            lambda: self._fail(exchange, "it is out of reach"),
        )  # fmt: skip

    def _new_token(self) -> bytes:
        while (token := self._random(wire.TOKEN_SIZE)) in self._exchanges:
            pass
        return token

    def _fail(self, exchange: PendingRequest, reason: str) -> None:
        self.cancel(exchange)
        exchange.on_answer(ThingUnreachable(f"{exchange.conversation.name}: {reason}"))


def _continues(exchange: PendingRequest, opened: Message) -> bool:
    """Whether a block is the next one, and of the same state (RFC 7959 section 2.4)."""
    before = exchange.received
    if before is not None and opened.opt.etag != exchange.tag:
        return False
    return bool(opened.opt.block2.start == len(before or b""))


def _put_block(message: Message, request: Request, number: int) -> None:
    body = request.body
    begin = number * MAX_BLOCK
    message.payload = body[begin : begin + MAX_BLOCK]
    if len(body) > MAX_BLOCK:
        more = begin + MAX_BLOCK < len(body)
        message.opt.block1 = BlockOption.BlockwiseTuple(number, more, _SZX)


def _answer(opened: Message, body: bytes) -> Answer:
    form = opened.opt.content_format
    return Answer(opened.code, None if form is None else int(form), body)

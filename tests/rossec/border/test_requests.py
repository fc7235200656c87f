"""Requests of the border router: blocks, observations, lost messages; a thing in memory answers."""

import os
from typing import Any

import aiocoap
import pytest
from aiocoap.numbers import codes
from aiocoap.optiontypes import BlockOption

from rossec.border import endpoint, messages
from rossec.border.conversations import MAX_BLOCK, MAX_BODY, MESSAGE_BURST, Conversation
from rossec.border.endpoint import DEADLINE, CoapAnswer, CoapRequest, Requests
from rossec.border.messages import MAX_RETRANSMIT, OscoreContext, Timers, Transmissions
from rossec.errors import DatagramRefused, ThingUnreachable

THING = ("::1", 5683, 0, 0)


class Line:
    """A border router's requests, and the thing's side of the context."""

    def __init__(self) -> None:
        self.sent: list[bytes] = []
        self.timers = Timers()
        send = Transmissions(lambda data, _: self.sent.append(data), self.timers, lambda: 0.0)
        self.open = Requests(send, self.timers, os.urandom)
        self.thing = OscoreContext(bytes(16), b"", b"t", b"")
        self.conversation = Conversation("/things/lamp", OscoreContext(bytes(16), b"", b"", b"t"), THING)
        self.answers: list[CoapAnswer | ThingUnreachable] = []
        self.opened: dict[bytes, tuple[aiocoap.Message, aiocoap.Message, Any]] = {}
        self.now = 0.0

    def ask(self, code: Any = codes.GET, **options: Any) -> Any:
        request = CoapRequest(code, ("t",), **options)
        return self.open.start(self.conversation, request, self.answers.append, self.now)

    def asked(self) -> tuple[aiocoap.Message, aiocoap.Message, Any]:
        """The last request: as it was sent, opened (once), and what an answer is bound to."""
        data = self.sent[-1]
        if data not in self.opened:
            self.opened[data] = (messages.read(data), *self.thing.open(messages.read(data)))
        return self.opened[data]

    def seal(
        self,
        sealed: aiocoap.Message,
        identifier: Any,
        code: Any = codes.CONTENT,
        payload: bytes = b"",
        **options: Any,
    ) -> aiocoap.Message:
        """An answer of the thing, as it arrives."""
        message = aiocoap.Message(code=code, payload=payload)
        for name, value in options.items():
            setattr(message.opt, name, value)
        answer, _ = self.thing.seal(message, identifier)
        if message.opt.observe is not None:
            answer.opt.observe = message.opt.observe
        answer.token, answer.mtype, answer.mid = sealed.token, messages.NON, 7
        return messages.read(messages.write(answer))

    def take(self, message: aiocoap.Message) -> None:
        found = self.open.find(message, THING)
        assert found is not None
        self.open.take(found, message, self.now)

    def reply(self, payload: bytes = b"", code: Any = codes.CONTENT, **options: Any) -> None:
        """The thing answers the last request."""
        sealed, _, identifier = self.asked()
        self.take(self.seal(sealed, identifier, code, payload, **options))


@pytest.fixture
def line() -> Line:
    return Line()


def test_a_request_and_its_answer(line: Line) -> None:
    line.ask(codes.PUT, body=b"on", format=60)
    sealed, opened, identifier = line.asked()
    assert (opened.code, opened.opt.uri_path, opened.payload) == (codes.PUT, ("t",), b"on")
    assert (int(opened.opt.content_format), sealed.mtype) == (60, messages.CON)
    line.take(line.seal(sealed, identifier, codes.CHANGED))
    assert line.answers == [CoapAnswer(codes.CHANGED, None, b"")]
    assert (len(line.open), line.conversation.tokens, len(line.timers)) == (0, set(), 0)


def test_only_the_thing_that_was_asked_answers(line: Line) -> None:
    line.ask()
    sealed, _, identifier = line.asked()
    answer = line.seal(sealed, identifier, payload=b"20")
    assert line.open.find(answer, ("::2", 5683, 0, 0)) is None
    forged = answer.copy(payload=answer.payload[:-1] + b"\0")
    forged.direction, forged.token = answer.direction, answer.token
    with pytest.raises(DatagramRefused):
        line.take(forged)
    assert line.answers == []
    line.take(answer)
    assert line.open.find(answer, THING) is None


def test_nobody_answers(line: Line) -> None:
    line.ask()
    while line.timers.next_due is not None:
        line.timers.run(line.timers.next_due)
    assert len(line.sent) == 1 + MAX_RETRANSMIT
    (failed,) = line.answers
    assert isinstance(failed, ThingUnreachable)
    assert "/things/lamp: it is out of reach" in str(failed)


def test_an_answer_that_does_not_come_after_the_acknowledgement(line: Line) -> None:
    exchange = line.ask()
    line.open._transmissions.acknowledge(THING, exchange.mid)
    line.timers.run(DEADLINE)
    assert [str(each) for each in line.answers] == ["/things/lamp: it did not answer in time"]


def test_a_conversation_that_ends_fails_what_was_asked(line: Line) -> None:
    line.ask()
    line.ask(observe=True)
    line.open.end(line.conversation)
    assert [str(each) for each in line.answers] == ["/things/lamp: its conversation has ended"] * 2
    assert len(line.open) == 0


def test_observed_states_in_their_order(line: Line) -> None:
    exchange = line.ask(observe=True)
    sealed, opened, identifier = line.asked()
    assert opened.opt.observe == 0
    states = [
        line.seal(sealed, identifier, payload=b"%d" % number, observe=number, content_format=60)
        for number in (1, 2, 3)
    ]
    for each in (states[0], states[2]):
        line.take(each)
    with pytest.raises(DatagramRefused):
        line.take(states[1])
    assert [each.body for each in line.answers if isinstance(each, CoapAnswer)] == [b"1", b"3"]
    assert len(line.open) == 1
    line.open.cancel(exchange)
    assert line.open.find(states[0], THING) is None


def test_more_states_than_its_rate_are_dropped(line: Line) -> None:
    line.ask(observe=True)
    sealed, _, identifier = line.asked()
    for number in range(1, 40):
        line.take(line.seal(sealed, identifier, observe=number))
    assert len(line.answers) == MESSAGE_BURST
    assert line.conversation.quota.dropped == 39 - MESSAGE_BURST


def test_an_unprotected_answer_ends_nothing_and_is_asked_again(line: Line) -> None:
    line.ask()
    for tries in range(endpoint.RETRIES + 2):
        sealed, _, _ = line.asked()
        plain = aiocoap.Message(code=codes.UNAUTHORIZED)
        plain.token, plain.mtype, plain.mid = sealed.token, messages.ACK, sealed.mid
        for _ in range(2):
            with pytest.raises(DatagramRefused):
                line.take(messages.read(messages.write(plain)))
        assert line.answers == []
        line.timers.run(endpoint.RETRY * 2**tries)
    assert len({bytes(messages.read(data).token) for data in line.sent}) == 1 + endpoint.RETRIES
    line.reply(b"20")
    assert [each.body for each in line.answers if isinstance(each, CoapAnswer)] == [b"20"]


def test_a_thing_that_learns_its_context_late_is_not_left_to_repetitions(line: Line) -> None:
    """Those it answers from its memory (RFC 7252 section 4.2): only a new message asks anew."""
    answered: set[int] = set()
    line.ask()
    while not line.answers and line.now < DEADLINE:
        sealed = messages.read(line.sent[-1])
        mid = messages.number_of(sealed)
        if mid not in answered and line.now >= 10:  # what told it its context was lost twice
            line.reply(b"20")
        elif mid not in answered:
            plain = aiocoap.Message(code=codes.UNAUTHORIZED)
            plain.token, plain.mtype, plain.mid = sealed.token, messages.ACK, mid
            with pytest.raises(DatagramRefused):
                line.take(messages.read(messages.write(plain)))
        answered.add(mid)
        line.now += 0.25
        line.timers.run(line.now)
    assert [each.body for each in line.answers if isinstance(each, CoapAnswer)] == [b"20"]
    assert line.now < 20


def block(number: int, more: bool) -> Any:
    return BlockOption.BlockwiseTuple(number, more, 6)


def test_an_answer_in_blocks(line: Line) -> None:
    body = os.urandom(2 * MAX_BLOCK + 5)
    line.ask()
    for number in range(3):
        _, opened, _ = line.asked()
        wanted = opened.opt.block2
        assert wanted is None if number == 0 else wanted.block_number == number
        part = body[number * MAX_BLOCK : (number + 1) * MAX_BLOCK]
        line.reply(part, block2=block(number, number < 2))
    assert line.answers == [CoapAnswer(codes.CONTENT, None, body)]


def test_a_body_in_blocks(line: Line) -> None:
    body = os.urandom(MAX_BLOCK + 9)
    line.ask(codes.POST, body=body, format=65001)
    first = line.asked()[1]
    assert (first.payload, first.opt.block1.more) == (body[:MAX_BLOCK], True)
    line.reply(code=codes.CONTINUE)
    second = line.asked()[1]
    assert (second.payload, second.opt.block1) == (body[MAX_BLOCK:], block(1, False))
    line.reply(b"done", codes.CHANGED)
    assert line.answers == [CoapAnswer(codes.CHANGED, None, b"done")]


@pytest.mark.parametrize("flaw", ["a gap", "a short block", "too long", "more than there is"])
def test_blocks_that_do_not_fit_are_given_up(line: Line, flaw: str) -> None:
    line.ask(codes.POST, body=b"x", format=60)
    full = bytes(MAX_BLOCK)
    match flaw:
        case "a gap":
            line.reply(full, block2=block(0, True))
            line.reply(full, block2=block(2, True))
        case "a short block":
            line.reply(b"x", block2=block(0, True))
        case "too long":
            for number in range(MAX_BODY // MAX_BLOCK + 1):
                line.reply(full, block2=block(number, True))
        case _:
            line.reply(code=codes.CONTINUE)
    (failed,) = line.answers
    assert isinstance(failed, ThingUnreachable)


def test_an_observed_state_in_blocks(line: Line) -> None:
    body = os.urandom(MAX_BLOCK + 1)
    line.ask(observe=True)
    line.reply(body[:MAX_BLOCK], observe=1, block2=block(0, True))
    line.reply(body[MAX_BLOCK:], block2=block(1, False))
    assert line.answers == [CoapAnswer(codes.CONTENT, None, body)]
    assert len(line.open) == 1


@pytest.mark.parametrize("more", [True, False])
def test_blocks_of_two_states_are_not_put_together(line: Line, more: bool) -> None:
    line.ask()
    size = MAX_BLOCK
    line.reply(b"a" * size, block2=BlockOption.BlockwiseTuple(0, True, 6), etag=b"1")
    line.reply(b"a" * size, block2=BlockOption.BlockwiseTuple(1, True, 6), etag=b"1")
    line.reply(b"b" * size, block2=BlockOption.BlockwiseTuple(2, more, 6), etag=b"2")
    (failed,) = line.answers
    assert isinstance(failed, ThingUnreachable)

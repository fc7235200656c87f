"""Replays to a border router: no sequence number of a context is used twice, no old state is new.

Whoever records the datagrams of a thing with a secret sends them again when the router has dropped
its context. Were the context derived anew, its nonces would begin again, with other plaintexts.
"""

import os
from typing import Any

import pytest
from aiocoap import Message
from aiocoap.numbers import codes
from aiocoap.optiontypes import BlockOption
from cryptography.hazmat.primitives.asymmetric import ec

from ca.things import ThingKey
from rossec.border import messages
from rossec.border.conversations import Conversation
from rossec.border.endpoint import CoapAnswer, CoapEndpoint, CoapRequest, Requests
from rossec.border.handshakes import StaticKey
from rossec.border.messages import (
    NONCE_SIZE,
    OscoreContext,
    Timers,
    Transmissions,
    name_context,
    thing_context,
    unwrapped,
    wrapped,
)
from rossec.errors import DatagramRefused, ThingUnreachable

SECRET, KID, LAMP = bytes(range(16)), b"\x07", "/things/lamp"
THING, EVE = ("::1", 40000, 0, 0), ("::1", 40001, 0, 0)


class Site:
    """What the endpoint asks and tells; and the lamp, whose datagrams are recorded."""

    def __init__(self) -> None:
        self.sent: list[bytes] = []
        self.now = 1000.0
        self.registrations = 0
        self.mid = 0
        key = StaticKey(ec.generate_private_key(ec.SECP256R1()))
        self.endpoint = CoapEndpoint(
            key, self, self, lambda data, _: self.sent.append(data), os.urandom, lambda: 0.0
        )
        self.context: OscoreContext
        self.value = b""

    def by_key(self, kid: bytes) -> tuple[str, ThingKey] | None:
        return None

    def by_secret(self, kid: bytes) -> tuple[str, bytes] | None:
        return (LAMP, SECRET) if kid == KID else None

    def registered(self, conversation: Conversation) -> None:
        self.registrations += 1
        request = CoapRequest(codes.GET, (".well-known", "core"))
        self.endpoint.requests.start(conversation, request, lambda _: None, self.now)

    def left(self, name: str) -> None:
        self.endpoint.conversations.drop(name)

    def ended(self, conversation: Conversation) -> None:
        pass

    def request(self, context: OscoreContext, value: bytes, code: Any = codes.POST) -> bytes:
        """The octets of a request of the lamp."""
        sealed, self.identifier = context.seal(Message(code=code, uri_path=("rd",)))
        name_context(sealed, wrapped(value))
        self.mid += 1
        sealed.mtype, sealed.mid, sealed.token = messages.CON, self.mid, b"t"
        return messages.write(sealed)

    def receive(self, data: bytes, source: Any = THING) -> None:
        self.endpoint.receive(data, source, self.now)

    def derive(self) -> bytes:
        """The lamp derives a context; returns the registration that begins it."""
        first = os.urandom(NONCE_SIZE)
        self.receive(self.request(thing_context(SECRET, KID, first), first))
        challenge = messages.read(self.sent[-1])
        challenge.code = codes.POST  # read as a request: only its option is of interest
        option = bytes(challenge.opt.oscore)
        value = unwrapped(option[2 : 2 + option[1]])
        self.value = value + os.urandom(NONCE_SIZE)
        self.context = thing_context(SECRET, KID, self.value)
        self.now += 0.01
        return self.request(self.context, self.value)

    def nonces(self, begin: int) -> list[bytes]:
        """Partial IVs of the router's requests since `begin`, in whichever context."""
        found = [messages.read(data) for data in self.sent[begin:]]
        return [bytes(each.opt.oscore) for each in found if each.code.is_request()]


@pytest.fixture
def site() -> Site:
    return Site()


@pytest.mark.attack("oscore-nonces")
@pytest.mark.parametrize("how", ["left", "dropped"])
def test_a_dropped_context_is_not_derived_again(site: Site, how: str) -> None:
    registration = site.derive()
    site.receive(registration)
    assert site.registrations == 1
    if how == "left":
        site.receive(site.request(site.context, site.value, codes.DELETE))
    else:
        site.endpoint.conversations.drop(LAMP)
    assert site.endpoint.conversations.of(LAMP) is None
    begin = len(site.sent)
    site.now += 5
    site.receive(registration, EVE)
    assert site.registrations == 1
    assert site.endpoint.conversations.of(LAMP) is None
    assert site.nonces(begin) == []
    site.receive(site.derive())  # the lamp itself comes back at once
    assert site.registrations == 2


@pytest.mark.attack("oscore-nonces")
def test_a_thing_that_counts_messages_anew_after_a_start_gets_no_old_answer(site: Site) -> None:
    """An answer is repeated to the same request, and not to another one with its message ID."""
    site.receive(site.derive())
    answered = site.sent[-2]
    site.mid = 0
    registration = site.derive()
    assert messages.number_of(messages.read(registration)) == messages.number_of(messages.read(answered))
    site.receive(registration)
    assert (site.registrations, answered in site.sent[-2:]) == (2, False)
    begin = len(site.sent)
    site.receive(registration)
    assert (site.registrations, len(site.sent)) == (2, begin + 1)


class Observed:
    """An observation of the lamp, by the router; the lamp's answers are recorded."""

    def __init__(self) -> None:
        timers = Timers()
        self.answers: list[CoapAnswer | ThingUnreachable] = []
        self.sent: list[bytes] = []
        send = Transmissions(lambda data, _: self.sent.append(data), timers, lambda: 0.0)
        self.requests = Requests(send, timers, os.urandom)
        self.lamp = OscoreContext(SECRET, b"", KID, b"")
        self.conversation = Conversation(LAMP, OscoreContext(SECRET, b"", b"", KID), THING)
        self.observe()

    def observe(self) -> None:
        request = CoapRequest(codes.GET, ("t",), observe=True)
        self.requests.start(self.conversation, request, self.answers.append, 0.0)
        self.request = messages.read(self.sent[-1])
        _, self.identifier = self.lamp.open(messages.read(self.sent[-1]))

    def notification(self, state: bytes, **options: Any) -> bytes:
        """The octets of a notification. As of a small thing, its Observe option is outside."""
        message = Message(code=codes.CONTENT, payload=state)
        for name, value in options.items():
            setattr(message.opt, name, value)
        sealed, _ = self.lamp.seal(message, self.identifier)
        sealed.opt.observe = 1
        return self.sendable(sealed)

    def sendable(self, sealed: Message) -> bytes:
        sealed.token, sealed.mtype, sealed.mid = self.request.token, messages.NON, 7
        return messages.write(sealed)

    def receive(self, data: bytes) -> None:
        message = messages.read(data)
        found = self.requests.find(message, THING)
        assert found is not None
        self.requests.take(found, message, 0.0)

    def without_observe(self, data: bytes) -> bytes:
        """What an attacker makes of a notification: the option that no tag covers is gone."""
        message = messages.read(data)
        bare = Message(code=message.code, payload=message.payload)
        bare.opt.oscore = message.opt.oscore
        return self.sendable(bare)


@pytest.mark.attack("oscore-nonces")
def test_an_old_state_that_says_it_is_no_notification() -> None:
    observed = Observed()
    first, *recorded = (observed.notification(b"%d" % each) for each in range(4))
    observed.receive(first)
    for data in recorded:
        observed.receive(data)
    assert len(observed.answers) == 4
    for data in (first, *recorded):
        for again in (data, observed.without_observe(data)):
            with pytest.raises(DatagramRefused, match="older"):
                observed.receive(again)
    observed.receive(observed.notification(b"new"))
    last = observed.answers[-1]
    assert isinstance(last, CoapAnswer)
    assert (last.body, len(observed.answers)) == (b"new", 5)


@pytest.mark.attack("oscore-nonces")
def test_a_state_whose_blocks_do_not_fit_does_not_end_its_observation() -> None:
    """Else it would be observed a second time, beside the first, whenever the thing registers."""
    observed = Observed()
    for _ in range(5):
        observed.receive(observed.notification(b"x" * 5, block2=BlockOption.BlockwiseTuple(0, True, 6)))
    assert (observed.answers, len(observed.requests)) == ([], 1)
    observed.receive(observed.notification(b"fits"))
    assert isinstance(observed.answers[0], CoapAnswer)

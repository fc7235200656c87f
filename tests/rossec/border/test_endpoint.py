"""The border router's side of CoAP, datagram by datagram: who is served, and who is answered."""

import os
from typing import Any

import aiocoap
import pytest
from aiocoap.numbers import codes
from cryptography.hazmat.primitives.asymmetric import ec
from hypothesis import given
from hypothesis import strategies as st

from ca.things import ThingKey
from rossec.border import messages
from rossec.border.conversations import MESSAGE_BURST, SOURCE_BURST, Conversation
from rossec.border.endpoint import HANDSHAKE_PATH, HANDSHAKES, CoapEndpoint, CoapRequest
from rossec.border.handshakes import StaticKey
from rossec.border.messages import (
    LIFETIME,
    R2_SIZE,
    OscoreContext,
    name_context,
    thing_context,
    unprotected,
    unwrapped,
    wrapped,
)
from tests.rossec.border.test_handshakes import Initiator

OWN = StaticKey(ec.generate_private_key(ec.SECP256R1()))
LAMP, FAN, KID, SECRET = "/things/lamp", "/things/fan", b"\x07", bytes(range(16))
HERE, ELSEWHERE = ("::1", 5683, 0, 0), ("::2", 5683, 0, 0)


class Router:
    """An endpoint; what it sent, and what it told."""

    def __init__(self) -> None:
        self.sent: list[tuple[bytes, Any]] = []
        self.told: list[str] = []
        self.lamp = Initiator(peer=OWN.credential)
        self.served = True
        self.now = 1000.0
        self.mid = 0
        self.endpoint = CoapEndpoint(
            OWN, self, self, lambda data, to: self.sent.append((data, to)), os.urandom, lambda: 0.5
        )

    # --- what it serves, and what happens

    def by_key(self, kid: bytes) -> tuple[str, ThingKey] | None:
        known = self.served and kid == self.lamp.credential.kid
        return (LAMP, self.lamp.credential) if known else None

    def by_secret(self, kid: bytes) -> tuple[str, bytes] | None:
        return (FAN, SECRET) if self.served and kid == KID else None

    def registered(self, conversation: Conversation) -> None:
        self.told.append(f"registered {conversation.name}")

    def left(self, name: str) -> None:
        self.told.append(f"left {name}")

    def ended(self, conversation: Conversation) -> None:
        self.told.append(f"ended {conversation.name}")

    # --- datagrams

    def send(self, message: Any, source: Any = HERE, kind: Any = messages.CON) -> bytes:
        """A message of a thing arrives; its bytes."""
        self.mid += 1
        message.mtype, message.mid, message.token = kind, self.mid, b"tk"
        data = messages.write(message)
        self.endpoint.receive(data, source, self.now)
        return data

    @property
    def answer(self) -> Any:
        return messages.read(self.sent[-1][0])

    def edhoc(self, payload: bytes, source: Any = HERE) -> Any:
        request = aiocoap.Message(code=codes.POST, uri_path=HANDSHAKE_PATH, payload=payload)
        self.send(request, source)
        return self.answer

    def begin(self, source: Any = HERE) -> tuple[bytes, bytes]:
        """The lamp's handshake up to message_3; returns C_R and that."""
        answer = self.edhoc(b"\xf5" + self.lamp.message_1(), source)
        assert answer.code == codes.CHANGED
        return self.lamp.message_3(answer.payload)

    def ask(
        self,
        context: OscoreContext,
        code: Any = codes.POST,
        path: str = "rd",
        message_3: bytes = b"",
        kid_context: bytes = b"",
        source: Any = HERE,
    ) -> tuple[Any, bytes, Any]:
        """A protected request of a thing; the answer opened, its bytes, and what binds it."""
        sealed, identifier = context.seal(aiocoap.Message(code=code, uri_path=(path,)))
        if kid_context:
            name_context(sealed, kid_context)
        if message_3:
            sealed.opt.edhoc, sealed.payload = True, message_3 + sealed.payload
        data = self.send(sealed, source)
        answer = self.answer
        if answer.opt.oscore is None:
            return answer, data, identifier
        return context.open(answer, identifier)[0], data, identifier

    def register(self) -> bytes:
        """The lamp is there; the bytes of its registration."""
        _, message_3 = self.begin()
        answer, data, _ = self.ask(self.lamp.context, message_3=message_3)
        assert answer.code == codes.CHANGED
        return data


@pytest.fixture
def router() -> Router:
    return Router()


def test_a_thing_registers_with_its_third_message(router: Router) -> None:
    router.register()
    assert router.told == [f"registered {LAMP}"]
    assert router.endpoint.conversations.of(LAMP) is not None
    octets = router.endpoint.counts.octets
    assert set(octets) == {"message_1", "message_2", "message_3"}
    assert sum(octets.values()) <= 110
    assert router.ask(router.lamp.context, path="other")[0].code == codes.NOT_FOUND
    assert router.ask(router.lamp.context, codes.DELETE)[0].code == codes.DELETED
    assert router.told[-1] == f"left {LAMP}"


def test_or_without_it(router: Router) -> None:
    peer_id, message_3 = router.begin()
    answer = router.edhoc(bytes((0x40 | len(peer_id),)) + peer_id + message_3)
    assert answer.code == codes.CHANGED
    assert answer.payload
    assert router.told == []
    assert router.ask(router.lamp.context)[0].code == codes.CHANGED
    assert router.told == [f"registered {LAMP}"]


def test_a_repeated_request_is_answered_and_not_carried_out_again(router: Router) -> None:
    data = router.register()
    first = router.sent[-1]
    router.endpoint.receive(data, HERE, router.now)
    assert router.sent[-1] == first
    router.endpoint.receive(data, ELSEWHERE, router.now)
    assert router.answer.code == codes.UNAUTHORIZED
    assert router.told == [f"registered {LAMP}"]


def test_a_new_handshake_ends_the_former_conversation(router: Router) -> None:
    router.register()
    router.register()
    assert router.told == [f"registered {LAMP}", f"ended {LAMP}", f"registered {LAMP}"]


def derive(router: Router, random: bytes = b"12345678") -> tuple[OscoreContext, bytes]:
    """The fan's two requests; its context, and the bytes of the second one."""
    first = thing_context(SECRET, KID, random)
    sealed, identifier = first.seal(aiocoap.Message(code=codes.POST, uri_path=("rd",)))
    name_context(sealed, wrapped(random))
    router.send(sealed)
    answer = router.answer
    _, _, found, _ = OscoreContext._extract_encrypted0(messages.read(router.sent[-1][0]))
    value_2 = unwrapped(next(each for key, each in found.items() if key == 10))
    assert len(value_2) == R2_SIZE
    opened, _ = thing_context(SECRET, KID, value_2 + random).open(answer, identifier)
    assert opened.code == codes.UNAUTHORIZED
    value = value_2 + b"87654321"
    context = thing_context(SECRET, KID, value)
    done, data, _ = router.ask(context, kid_context=wrapped(value))
    assert done.code == codes.CHANGED
    return context, data


def test_a_thing_with_a_secret_registers_in_two_requests(router: Router) -> None:
    context, data = derive(router)
    assert router.told == [f"registered {FAN}"]
    assert router.endpoint.counts.derivations == 1
    assert router.ask(context)[0].code == codes.CHANGED
    router.endpoint.receive(data, ELSEWHERE, router.now)
    assert router.answer.code == codes.UNAUTHORIZED
    assert router.told.count(f"registered {FAN}") == 2


def test_recorded_derivations_make_nothing_new(router: Router) -> None:
    _, data = derive(router)
    router.now += 1
    derive(router, b"abcdefgh")
    told = list(router.told)
    for late in (0, LIFETIME / 1000 + 1):
        router.now += late
        router.endpoint.receive(data, ELSEWHERE, router.now)
        assert router.endpoint.counts.derivations == 2
        assert router.told == told


def test_who_is_not_served_learns_nothing(router: Router) -> None:
    """One answer to everything, and none to what asks for no acknowledgement."""
    router.served = False
    _, message_3 = router.begin()
    plain = aiocoap.Message(code=codes.GET, uri_path=("rd",))
    answers = {
        router.ask(router.lamp.context, message_3=message_3)[0].code,
        router.ask(thing_context(SECRET, KID, bytes(8)), kid_context=wrapped(bytes(8)))[0].code,
        router.ask(OscoreContext(SECRET, b"", b"x", b""))[0].code,
    }
    router.send(plain)
    answers.add(router.answer.code)
    assert {int(each) for each in answers} == {int(codes.UNAUTHORIZED)}
    count = len(router.sent)
    router.send(aiocoap.Message(code=codes.GET, uri_path=("rd",)), kind=messages.NON)
    assert len(router.sent) == count
    assert router.told == []
    assert len(router.endpoint.conversations) == 0


def test_a_thing_that_asks_too_often_is_told_so(router: Router) -> None:
    router.register()
    found = [router.ask(router.lamp.context)[0].code for _ in range(int(MESSAGE_BURST) + 3)]
    assert found[-1] == codes.TOO_MANY_REQUESTS
    assert found[0] == codes.CHANGED


def test_a_flood_of_handshakes_spares_the_things_that_are_there(router: Router) -> None:
    router.register()
    for number in range(int(HANDSHAKES) * 3):
        router.edhoc(b"\xf5" + Initiator().message_1(), (f"::{number:x}", 1, 0, 0))
    assert router.endpoint.counts.over_budget >= HANDSHAKES
    assert router.ask(router.lamp.context)[0].code == codes.CHANGED
    router.now += 1
    for _ in range(20):
        router.edhoc(b"\xf5" + Initiator().message_1(), ELSEWHERE)
    assert router.answer.code == codes.UNAUTHORIZED
    assert SOURCE_BURST < 20
    router.register()


def test_pings_resets_and_answers_that_nobody_waits_for(router: Router) -> None:
    router.endpoint.receive(messages.empty(messages.CON, 9), HERE, router.now)
    assert router.sent[-1] == (messages.empty(messages.RST, 9), HERE)
    count = len(router.sent)
    for data in (messages.empty(messages.ACK, 9), messages.empty(messages.RST, 9), b"", b"\x40"):
        router.endpoint.receive(data, HERE, router.now)
    assert len(router.sent) == count
    router.send(aiocoap.Message(code=codes.CONTENT), kind=messages.CON)
    assert router.sent[-1][0][:2] == bytes((0x40 | messages.RST << 4, 0))


def test_the_router_asks_a_thing_in_the_same_context(router: Router) -> None:
    router.register()
    conversation = router.endpoint.conversations.of(LAMP)
    assert conversation is not None
    answers: list[Any] = []
    router.endpoint.requests.start(conversation, CoapRequest(codes.GET, ("t",)), answers.append, router.now)
    sealed = router.answer
    opened, identifier = router.lamp.context.open(messages.read(router.sent[-1][0]))
    assert (opened.code, opened.opt.uri_path) == (codes.GET, ("t",))
    assert unprotected(sealed)[0] == router.lamp._own_id
    answer, _ = router.lamp.context.seal(aiocoap.Message(code=codes.CONTENT, payload=b"20"), identifier)
    answer.token, answer.mtype, answer.mid = sealed.token, messages.CON, 77
    router.endpoint.receive(messages.write(answer), HERE, router.now)
    assert [each.body for each in answers] == [b"20"]
    assert router.sent[-1][0] == messages.empty(messages.ACK, 77)
    router.endpoint.conversations.drop(LAMP)
    assert router.told[-1] == f"ended {LAMP}"
    router.endpoint.timers.run(router.now + 1000)


@pytest.mark.parametrize("payload", [b"", b"\x00", b"\x43ab", b"\x43abc", b"\xf5", b"\x58\xff"])
def test_malformed_handshakes_are_refused(router: Router, payload: bytes) -> None:
    assert router.edhoc(payload).code == codes.UNAUTHORIZED
    sealed, _ = OscoreContext(SECRET, b"", b"x", b"").seal(aiocoap.Message(code=codes.POST))
    sealed.opt.edhoc, sealed.payload = True, payload
    router.send(sealed)
    assert router.answer.code == codes.UNAUTHORIZED


@given(st.binary(max_size=100))
def test_any_datagram_is_taken_without_harm(data: bytes) -> None:
    router = Router()
    router.endpoint.receive(data, HERE, router.now)
    assert router.told == []

"""EDHOC with things, as the responder: lakers on the other side."""

import itertools
import os
from typing import Any

import lakers
import pytest
from aiocoap import POST, Message
from cryptography.hazmat.primitives.asymmetric import ec
from hypothesis import given
from hypothesis import strategies as st

from ca.things import ThingKey
from rossec.border import handshakes, messages
from rossec.border.handshakes import ID_SIZE, PENDING_FOR, Handshakes, StaticKey
from rossec.border.messages import KEY_SIZE, MAX_ID, SALT_SIZE, OscoreContext
from rossec.errors import ThingError

OWN = StaticKey(ec.generate_private_key(ec.SECP256R1()))
HERE, NOW = ("::1", 5683, 0, 0), 100.0


class Initiator:
    """A thing: its key, and one handshake of it."""

    def __init__(self, kid: bytes = b"\x2c", peer: ThingKey = OWN.credential) -> None:
        key = ec.generate_private_key(ec.SECP256R1())
        self.private = key.private_numbers().private_value.to_bytes(32)
        self.credential, self.peer = ThingKey.of(key.public_key(), kid), peer
        self.context: OscoreContext

    def message_1(self, own_id: bytes = b"\x05") -> bytes:
        self._own_id, self._lakers = own_id, lakers.EdhocInitiator()
        return bytes(self._lakers.prepare_message_1(own_id, None))

    def message_3(self, message_2: bytes) -> tuple[bytes, bytes]:
        """C_R, and the message."""
        peer_id, _, _ = self._lakers.parse_message_2(message_2)
        self._lakers.verify_message_2(self.private, self.credential.ccs, self.peer.ccs)
        by_reference = lakers.CredentialTransfer.ByReference
        message = bytes(self._lakers.prepare_message_3(by_reference, None)[0])
        self._lakers.completed_without_message_4()
        secret = bytes(self._lakers.edhoc_exporter(0, [], KEY_SIZE))
        salt = bytes(self._lakers.edhoc_exporter(1, [], SALT_SIZE))
        self.context = OscoreContext(secret, salt, bytes(peer_id), self._own_id)
        return bytes(peer_id), message


def made(*things: Initiator, **changes: Any) -> Handshakes:
    """Handshakes with these things."""
    known = {each.credential.kid: each.credential for each in things}
    given: dict[str, Any] = {"find": known.get, "is_taken": lambda _: False, "random": os.urandom}
    return Handshakes(OWN, **(given | changes))


def test_both_sides_have_the_same_context_after_three_small_messages() -> None:
    thing = Initiator()
    responder = made(thing)
    message_1 = thing.message_1()
    message_2 = responder.begin(message_1, HERE, NOW)
    peer_id, message_3 = thing.message_3(message_2)
    assert len(message_1) + len(message_2) + len(message_3) <= 110
    assert len(peer_id) == ID_SIZE
    found = responder.finish(peer_id, message_3, NOW + 1)
    assert (found.key, len(responder)) == (thing.credential, 0)
    sealed, _ = thing.context.seal(Message(code=POST, uri_path=("rd",)))
    sealed.mtype, sealed.mid, sealed.token = messages.CON, 1, b""
    opened, _ = found.context.open(messages.read(messages.write(sealed)))
    assert opened.opt.uri_path == ("rd",)


def test_a_handshake_is_finished_once() -> None:
    thing = Initiator()
    responder = made(thing)
    peer_id, message_3 = thing.message_3(responder.begin(thing.message_1(), HERE, NOW))
    responder.finish(peer_id, message_3, NOW)
    with pytest.raises(ThingError, match="no such handshake"):
        responder.finish(peer_id, message_3, NOW)


def test_a_repeated_message_1_gets_the_same_answer() -> None:
    thing = Initiator()
    responder = made(thing)
    message_1 = thing.message_1()
    message_2 = responder.begin(message_1, HERE, NOW)
    assert responder.repeated(message_1, HERE) == message_2
    assert responder.repeated(message_1, ("::2", 1, 0, 0)) is None
    responder.finish(*thing.message_3(message_2), NOW)
    assert responder.repeated(message_1, HERE) is None


@pytest.mark.parametrize("flaw", ["unknown kid", "another key", "changed", "too long"])
def test_who_does_not_prove_a_key_is_refused(flaw: str) -> None:
    thing, eve = Initiator(), Initiator()
    responder = made() if flaw == "unknown kid" else made(thing)
    attacker = eve if flaw == "another key" else thing
    peer_id, message_3 = attacker.message_3(responder.begin(attacker.message_1(), HERE, NOW))
    if flaw == "changed":
        message_3 = message_3[:-1] + bytes([message_3[-1] ^ 1])
    elif flaw == "too long":
        message_3 += bytes(handshakes.MAX_MESSAGE_3)
    with pytest.raises(ThingError):
        responder.finish(peer_id, message_3, NOW)
    assert len(responder) == 0


def test_a_thing_that_expects_another_router_goes_no_further() -> None:
    other = StaticKey(ec.generate_private_key(ec.SECP256R1())).credential
    thing = Initiator(peer=other)
    message_2 = made(thing).begin(thing.message_1(), HERE, NOW)
    with pytest.raises(Exception, match=r"EDHOCError|MacVerification"):
        thing.message_3(message_2)


def test_unfinished_handshakes_end_and_are_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(handshakes, "MAX_PENDING", 4)
    thing = Initiator()
    responder = made(thing)
    first = responder.begin(thing.message_1(), HERE, NOW)
    late = thing.message_3(first)
    for number in range(9):
        responder.begin(Initiator().message_1(), number, NOW)
    assert len(responder) == 4
    with pytest.raises(ThingError, match="no such handshake"):
        responder.finish(*late, NOW)
    responder.expire(NOW + PENDING_FOR)
    assert len(responder) == 0


@pytest.mark.parametrize("data", [b"", b"\x03", bytes(handshakes.MAX_MESSAGE_1 + 1), b"\xff" * 40])
def test_malformed_openings_are_refused(data: bytes) -> None:
    with pytest.raises(ThingError):
        made().begin(data, HERE, NOW)


@given(st.binary(max_size=60))
def test_any_bytes_are_refused_and_nothing_of_lakers_gets_out(data: bytes) -> None:
    responder = made(Initiator())
    try:
        responder.begin(data, HERE, NOW)
    except ThingError:
        return
    with pytest.raises(ThingError):
        responder.finish(next(iter(responder._pending)), data, NOW)


def test_ids_are_those_of_nobody_else() -> None:
    values = itertools.cycle([b"aaa", b"bbb"])
    thing = Initiator()
    responder = made(thing, is_taken=lambda each: each == b"aaa", random=lambda _: next(values))
    peer_id, _ = thing.message_3(responder.begin(thing.message_1(), HERE, NOW))
    assert peer_id == b"bbb"
    with pytest.raises(ThingError, match="no free ID"):
        responder.begin(Initiator().message_1(), HERE, NOW)


def test_the_routers_credential_is_small_and_of_its_key() -> None:
    assert len(OWN.credential.kid) == 1
    assert len(OWN.private) == 32
    assert OWN.credential.subject == ""


def test_a_point_that_is_not_on_the_curve_does_not_reach_lakers(capfd: pytest.CaptureFixture[str]) -> None:
    """A panic there writes a stack trace to stderr, and anybody can send this."""
    message_1 = Initiator().message_1()
    at = message_1.index(b"\x58\x20") + 2
    with pytest.raises(ThingError, match="curve"):
        made().begin(message_1[:at] + bytes(31) + b"\1" + message_1[at + 32 :], HERE, NOW)
    for size in range(len(message_1)):
        with pytest.raises(ThingError):
            made().begin(message_1[:size], HERE, NOW)
    assert capfd.readouterr().err == ""


def test_more_suites_than_one_are_read() -> None:
    message_1 = Initiator().message_1()
    assert message_1[:2] == b"\x03\x02"
    made().begin(b"\x03\x82\x06\x02" + message_1[2:], HERE, NOW)
    made().begin(b"\x03\x82\x18\x18\x02" + message_1[2:], HERE, NOW)


def test_an_id_that_does_not_fit_into_a_nonce_is_refused() -> None:
    thing = Initiator()
    responder = made(thing)
    message_2 = responder.begin(thing.message_1(b"\x40" * (MAX_ID + 1)), HERE, NOW)
    initiator = thing._lakers
    peer_id, _, _ = initiator.parse_message_2(message_2)
    initiator.verify_message_2(thing.private, thing.credential.ccs, OWN.credential.ccs)
    message_3 = initiator.prepare_message_3(lakers.CredentialTransfer.ByReference, None)[0]
    with pytest.raises(ThingError, match="nonce"):
        responder.finish(bytes(peer_id), bytes(message_3), NOW)

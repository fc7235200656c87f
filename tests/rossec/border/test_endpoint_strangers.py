"""Strangers at a border router: what they cannot end, and what they cannot tell."""

from typing import Any

import aiocoap
import pytest
from aiocoap.numbers import codes

from rossec.border import messages
from rossec.border.endpoint import HANDSHAKE_PATH, CoapRequest
from rossec.border.messages import OscoreContext
from tests.rossec.border.test_endpoint import ELSEWHERE, HERE, LAMP, SECRET, Router
from tests.rossec.border.test_handshakes import Initiator


@pytest.fixture
def router() -> Router:
    return Router()


def test_forged_resets_end_no_request(router: Router) -> None:
    """Four octets, from the address of the thing: all message IDs there are."""
    router.register()
    conversation = router.endpoint.conversations.of(LAMP)
    assert conversation is not None
    answers: list[Any] = []
    router.endpoint.requests.start(
        conversation, CoapRequest(codes.POST, ("open",)), answers.append, router.now
    )
    asked = router.sent[-1][0]
    for mid in range(0x10000):
        router.endpoint.receive(messages.empty(messages.RST, mid), HERE, router.now)
    assert answers == []
    router.endpoint.timers.run(router.now + 4)
    assert router.sent[-1] == (asked, HERE), "the very same: it may have been carried out"
    _, identifier = router.lamp.context.open(messages.read(asked))
    answer, _ = router.lamp.context.seal(aiocoap.Message(code=codes.CHANGED), identifier)
    answer.mtype, answer.mid, answer.token = messages.CON, 3, messages.read(asked).token
    router.endpoint.receive(messages.write(answer), HERE, router.now)
    assert [each.code for each in answers] == [codes.CHANGED]


def test_a_stranger_learns_no_message_id_of_others(router: Router) -> None:
    """Each thing has its own count, from a random number; a stranger gets random numbers."""
    router.register()
    conversation = router.endpoint.conversations.of(LAMP)
    assert conversation is not None
    told: set[int] = set()
    for number in range(30):
        first = aiocoap.Message(
            code=codes.POST, uri_path=HANDSHAKE_PATH, payload=b"\xf5" + Initiator().message_1()
        )
        router.send(first, (f"{number + 1:x}::1", 9, 0, 0), messages.NON)
        told.add(router.answer.mid)
    gaps = {abs(a - b) for a in told for b in told if a != b}
    assert len(told) > 25
    assert max(gaps) > 1000
    assert conversation.new_mid() not in told


@pytest.mark.parametrize("kid", ["in use", "unknown", "in use and repeated"])
def test_an_unknown_kid_costs_what_a_known_one_costs(
    router: Router, kid: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Both are decrypted once, or the time tells which of them is in use."""
    router.register()
    known: bytes = router.lamp.context.sender_id
    decrypted: list[bytes] = []
    algorithm = type(router.endpoint._decoy.alg_aead)
    stock = algorithm.decrypt

    def counted(cls: Any, ciphertext: bytes, *rest: Any) -> Any:
        decrypted.append(ciphertext)
        return stock(ciphertext, *rest)

    monkeypatch.setattr(algorithm, "decrypt", classmethod(counted))
    eve = OscoreContext(SECRET, b"", bytes((known[0] ^ (kid == "unknown"),)) + known[1:], b"")
    eve.sender_sequence_number = 0 if kid == "in use and repeated" else 5
    sealed, _ = eve.seal(aiocoap.Message(code=codes.POST, uri_path=("rd",)))
    router.send(sealed, ELSEWHERE)
    assert router.answer.code == codes.UNAUTHORIZED
    assert len(decrypted) == 1

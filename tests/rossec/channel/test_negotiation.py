"""What ends a handshake: unknown peers, errors, other suites, plain ROS."""

import dataclasses

import pytest

from rossec.channel.connection import Connection
from rossec.channel.edhoc.handshake import EdhocConfig
from rossec.channel.edhoc.messages import encode_error
from rossec.channel.negotiation import ConnectionState
from rossec.channel.opening import REFUSAL, WireProtocol, tcpros_refusal
from rossec.channel.records import Frame, frame
from rossec.errors import HandshakeFailed, IdentityRefused, PeerRefused, PlainPeer, ProtocolViolation
from tests.support.wire import ALICE, NOW, STRANGER, FakeIdentity, alice, bob, dice, peers, receive, wire


def test_the_responder_refuses_an_unknown_peer_without_a_reason() -> None:
    w = wire(alice(credentials=STRANGER)).pump()
    assert isinstance(w.right.error, IdentityRefused)
    assert "not signed by this site's authority" in str(w.right.error)
    assert w.right.error.hint == "enroll the node"
    assert isinstance(w.left.error, PeerRefused)
    assert str(w.left.error) == "the peer refused the handshake: handshake refused"
    assert peers(w.right) == []


def test_the_initiator_refuses_an_unknown_peer() -> None:
    w = wire(right=bob(credentials=STRANGER)).pump()
    assert isinstance(w.left.error, IdentityRefused)
    assert isinstance(w.right.error, PeerRefused)
    assert peers(w.left) == []


def test_ones_own_certificate_is_refused() -> None:
    w = wire(alice(), bob(credentials=ALICE)).pump()
    assert isinstance(w.left.error, IdentityRefused)
    assert "own certificate" in str(w.left.error)


def test_a_shared_certificate_is_not_a_reflection() -> None:
    shared = dataclasses.replace(ALICE, shared=True)
    w = wire(alice(credentials=shared), bob(credentials=shared)).pump()
    assert (w.left.error, w.right.error) == (None, None)
    assert peers(w.left) == peers(w.right) == ["/alice"]


def test_an_own_certificate_that_is_not_shared_is_refused_from_a_sharing_peer() -> None:
    w = wire(alice(), bob(credentials=dataclasses.replace(ALICE, shared=True))).pump()
    assert isinstance(w.left.error, IdentityRefused)


def test_a_bug_in_verify_ends_the_connection() -> None:
    def broken(chain: tuple[bytes, ...], now: int) -> FakeIdentity:
        raise ZeroDivisionError

    w = wire()
    core = Connection[FakeIdentity].initiator(EdhocConfig(ALICE, broken, dice("x")), now=NOW)
    w.right.give(bytes(core.data_to_send()))
    with pytest.raises(ZeroDivisionError):
        receive(core, w.right.take(), NOW)
    assert core.state is ConnectionState.CLOSED
    assert core.data_to_send() == b""


def test_the_initiator_tries_once_more_with_the_suite_of_the_responder() -> None:
    w = wire(alice(suites=(4, 6)), bob(suites=(6,))).pump()
    assert peers(w.left) == ["/bob"]
    assert peers(w.right) == ["/alice"]


def test_no_common_suite() -> None:
    w = wire(alice(suites=(4,)), bob(suites=(6,))).pump()
    assert isinstance(w.left.error, HandshakeFailed)
    assert "no cipher suite" in str(w.left.error)


def test_a_responder_answers_a_wrong_suite_once() -> None:
    flight = bytes(alice(suites=(4,)).data_to_send())
    core = bob()
    receive(core, flight, NOW)
    assert core.data_to_send() == frame(Frame.ERROR, encode_error(2, 6))
    with pytest.raises(HandshakeFailed):
        receive(core, flight[16:], NOW)


def test_an_initiator_does_not_retry_twice() -> None:
    w = wire(alice(suites=(4, 6)))
    w.left.take()
    w.left.give(frame(Frame.ERROR, encode_error(2, 6)))
    assert w.left.take()
    w.left.give(frame(Frame.ERROR, encode_error(2, 6)))
    assert isinstance(w.left.error, PeerRefused)
    assert w.left.take() == b""


def test_an_error_message_is_never_answered() -> None:
    w = wire()
    w.left.take()
    w.left.give(frame(Frame.ERROR, b"\xff"))
    assert isinstance(w.left.error, HandshakeFailed)
    assert w.left.take() == b""


def test_a_plain_caller_receives_the_refusal() -> None:
    core = bob()
    request = b"\x0a\0\0\0" + b"\x06\0\0\0a=bcde"
    receive(core, request[:-1], NOW)
    assert core.state is ConnectionState.DRAINING
    with pytest.raises(PlainPeer):
        receive(core, request[-1:], NOW)
    assert core.data_to_send() == tcpros_refusal(REFUSAL)


def test_an_opening_that_is_not_accepted_receives_the_refusal() -> None:
    w = wire(alice(WireProtocol.HTTP), bob(accept=frozenset({WireProtocol.TCPROS}))).pump()
    assert isinstance(w.right.error, PlainPeer)
    assert isinstance(w.left.error, PlainPeer)
    assert "200 OK" in str(w.left.error)


def test_a_plain_node_answers() -> None:
    core = alice()
    with pytest.raises(PlainPeer, match="no topic or service name detected"):
        receive(core, tcpros_refusal("no topic or service name detected"), NOW)


def test_garbage_is_dropped_silently() -> None:
    core = bob()
    with pytest.raises(ProtocolViolation):
        receive(core, b"\xff" * 100, NOW)
    assert core.data_to_send() == b""


@pytest.mark.parametrize("suites", [(-24,), (-24, 6)])
def test_the_hybrid_suite(suites: tuple[int, ...]) -> None:
    w = wire(alice(suites=suites), bob(suites=suites)).pump()
    assert w.right.core._session is not None
    assert w.right.core._session._epochs._suite.number == -24
    w.left.core.send_unit(b"x")
    assert w.pump().right.units == [b"x"]


def test_required_hybrid_suites_refuse_classical_peers() -> None:
    w = wire(alice(suites=(6,)), bob(suites=(-24,))).pump()
    assert isinstance(w.left.error, HandshakeFailed)
    assert peers(w.right) == []
    assert peers(wire(alice(suites=(-24, 6)), bob(suites=(6,))).pump().right) == ["/alice"]
    assert peers(wire(alice(suites=(6,)), bob(suites=(-24, 6))).pump().right) == ["/alice"]

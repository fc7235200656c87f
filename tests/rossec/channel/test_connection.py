import dataclasses

import pytest

from rossec.channel.connection import Connection
from rossec.channel.edhoc.known import KnownCertificates
from rossec.channel.edhoc.messages import encode_error
from rossec.channel.opening import REFUSAL, WireProtocol, tcpros_refusal
from rossec.channel.records import Bytes, ChannelLimits, Frame, frame
from rossec.channel.states import TABLE, Authenticated, Closed, ConnectionState
from rossec.errors import (
    ChannelClosed,
    ChannelError,
    ConnectionTruncated,
    HandshakeFailed,
    HandshakeTimeout,
    IdentityExpired,
    IdentityRefused,
    LimitExceeded,
    OwnCredentialUnknown,
    PeerCredentialUnknown,
    PeerRefused,
    PlainPeer,
    ProtocolViolation,
    RecordForged,
)
from rossec.progress import STEP, WINDOW
from tests.support.wire import (
    ALICE,
    NOT_AFTER,
    NOW,
    STRANGER,
    End,
    FakeIdentity,
    Wire,
    alice,
    bob,
    dice,
    joined,
    wire,
)

SMALL = ChannelLimits(records=4, octets=1 << 20, seconds=100, unit=1 << 20)


def names(end: End) -> list[str]:
    return [event.identity.name for event in end.events if isinstance(event, Authenticated)]


@pytest.mark.parametrize("step", [0, 1, 7])
@pytest.mark.parametrize("protocol", list(WireProtocol))
def test_a_connection_from_end_to_end(protocol: WireProtocol, step: int) -> None:
    w = wire(alice(protocol), step=step).pump()
    assert names(w.left) == ["/bob"]
    assert names(w.right) == ["/alice"]
    w.left.core.send_unit(b"hello ", bytearray(b"bob"))
    w.right.core.send_unit(b"hello ", memoryview(b"alice"))
    w.pump()
    assert w.right.units == [b"hello bob"]
    assert w.left.units == [b"hello alice"]
    w.left.core.close()
    w.pump()
    assert w.right.events[-1] == Closed()
    w.left.core.receive_eof()
    w.right.core.receive_eof()
    assert w.left.core.state is ConnectionState.CLOSED
    assert w.right.core.state is ConnectionState.CLOSED
    assert w.right.core.protocol is protocol
    assert w.left.error is None
    assert w.right.error is None


def test_the_first_record_may_travel_with_message_3() -> None:
    w = wire()
    w.right.give(w.left.take())
    w.left.give(w.right.take())
    w.left.core.send_unit(b"early")
    w.right.give(w.left.take())
    assert w.right.units == [b"early"]


def test_a_state_that_is_not_in_the_table_ends_the_connection(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    w = joined()
    monkeypatch.setattr(Connection, "_on_data_end", lambda *_: ConnectionState.CLOSING)
    w.left.core.send_unit(b"x")
    with pytest.raises(RuntimeError, match=r"_on_data_end led to state ConnectionState.CLOSING"):
        w.right.give(w.left.take())
    assert w.right.core.state is ConnectionState.CLOSED
    assert w.right.core.data_to_send() == b""


def test_large_units_of_many_pieces() -> None:
    w = joined()
    pieces: list[Bytes] = [
        b"a",
        b"b" * 300_000,
        bytearray(b"c" * 20_000),
        b"",
        b"d",
        memoryview(b"e" * 700_000),
    ]
    w.right.core.send_unit(*pieces)
    w.right.core.send_unit(b"f" * 600_000)
    w.pump()
    assert w.left.units == [b"".join(pieces), b"f" * 600_000]


def test_an_empty_unit_sends_nothing() -> None:
    w = joined()
    w.left.core.send_unit()
    w.left.core.send_unit(b"")
    assert w.left.take() == b""


def test_a_unit_beyond_the_limit_is_refused_before_anything_happens() -> None:
    w = joined(left=alice(limits=ChannelLimits(unit=10)))
    with pytest.raises(LimitExceeded, match="11 bytes"):
        w.left.core.send_unit(b"x" * 11)
    w.left.core.send_unit(b"x" * 10)
    assert w.pump().right.units == [b"x" * 10]


@pytest.mark.parametrize("size", [11, 300_000])
def test_a_peer_that_sends_a_unit_beyond_the_limit(size: int) -> None:
    w = joined(right=bob(limits=ChannelLimits(unit=10)))
    w.left.core.send_unit(b"x" * size)
    assert isinstance(w.pump().right.error, LimitExceeded)
    assert w.right.units == []


def test_a_peer_is_given_more_room_once_it_is_welcome() -> None:
    limits = ChannelLimits(unit=100, preauth_limit=10)
    w = joined(right=bob(limits=limits))
    w.left.core.send_unit(b"x" * 10)
    w.pump().right.core.raise_unit_limit()
    w.left.core.send_unit(b"y" * 100)
    assert w.pump().right.units == [b"x" * 10, b"y" * 100]
    w.left.core.send_unit(b"z" * 101)
    assert isinstance(w.pump().right.error, LimitExceeded)
    w = joined(right=bob(limits=limits))
    w.left.core.send_unit(b"x" * 11)
    assert isinstance(w.pump().right.error, LimitExceeded)
    with pytest.raises(ChannelError):
        wire().right.core.raise_unit_limit()


def test_who_was_judged_is_given_what_its_messages_need() -> None:
    w = joined(right=bob(limits=ChannelLimits(unit=100)))
    w.right.core.raise_unit_limit(20)
    w.left.core.send_unit(b"x" * 20)
    assert w.pump().right.units == [b"x" * 20]
    w.left.core.send_unit(b"x" * 21)
    assert isinstance(w.pump().right.error, LimitExceeded)
    w = joined(right=bob(limits=ChannelLimits(unit=100)))
    w.right.core.raise_unit_limit(1000)
    w.left.core.send_unit(b"x" * 101)
    assert isinstance(w.pump().right.error, LimitExceeded), "never more than the channel takes"


def begins(end: End) -> bool:
    return end.core.has_unfinished_unit


def test_a_unit_that_was_begun_must_get_on() -> None:
    """Whether bytes come or not; only while this side reads; small units are begun and ended."""
    w = joined(right=bob())
    core, begun = w.right.core, w.left.core.seal_unit(bytes(1_000_000))
    before = core.deadline()
    assert begins(w.right) is False
    core.receive_data(next(begun), NOW)
    assert begins(w.right) is True
    assert core.deadline() == NOW + STEP
    for second in range(0, 10 * WINDOW, STEP):
        core.tick(NOW + second, reading=False)
        assert core.deadline() == NOW + second + STEP
    start = NOW + 10 * WINDOW
    for second in range(0, WINDOW - STEP, STEP):
        core.tick(start + second)
    core.receive_data(next(begun), start + WINDOW)
    for record in begun:
        core.receive_data(record, start + 2 * WINDOW)
    assert begins(w.right) is False
    assert core.deadline() == before
    core.receive_data(next(w.left.core.seal_unit(bytes(1_000_000))), start)
    with pytest.raises(LimitExceeded, match="not whole after 60 seconds"):  # noqa: PT012 - at last
        for second in range(0, 2 * WINDOW, STEP):
            core.tick(start + second)
    assert core.deadline() is None
    assert core.state is ConnectionState.CLOSED


def test_a_unit_that_comes_in_drops_is_given_up() -> None:
    w = joined(right=bob())
    core = w.right.core
    with pytest.raises(LimitExceeded, match="not whole after 600 seconds"):  # noqa: PT012 - at last
        for second, record in enumerate(w.left.core.seal_unit(bytes(200 * 1024 * 1024))):
            core.receive_data(record, NOW + second)


def test_sending_before_the_handshake_and_after_the_close() -> None:
    w = wire()
    with pytest.raises(ChannelClosed):
        w.right.core.send_unit(b"too early")
    w.pump()
    w.left.core.close()
    with pytest.raises(ChannelClosed):
        w.left.core.send_unit(b"too late")
    w.left.core.close()
    assert w.left.core.state is ConnectionState.CLOSING


def test_closing_during_the_handshake_sends_nothing() -> None:
    core = bob()
    core.close()
    assert core.state is ConnectionState.CLOSED
    assert core.data_to_send() == b""
    assert core.receive_data(b"whatever", NOW) == []


def test_the_close_in_the_middle_of_a_unit_is_a_truncation() -> None:
    w = joined()
    records = w.left.core.seal_unit(b"x" * 600_000)
    w.right.give(bytes(next(records)))
    w.left.core.close()
    with pytest.raises(ChannelClosed):
        next(records)
    assert isinstance(w.pump().right.error, ConnectionTruncated)
    assert w.right.units == []


def test_records_sealed_meanwhile_go_first() -> None:
    w = joined(left=alice(limits=SMALL), right=bob(limits=SMALL))
    for _ in range(4):
        w.right.core.send_unit(b"to alice")
    records = w.left.core.seal_unit(b"x" * 300_000)
    sent = [next(records)]
    w.right.core.send_unit(b"after the rekey")
    w.left.give(w.right.take())  # alice follows the rekey, in the middle of her unit
    sent += records
    w.right.give(b"".join(sent))
    assert w.pump().right.units == [b"x" * 300_000]
    assert w.left.units[-1] == b"after the rekey"


# -- the end without a close


@pytest.mark.parametrize("side", ["left", "right"])
def test_the_end_without_close_is_a_truncation(side: str) -> None:
    end: End = getattr(joined(), side)
    with pytest.raises(ConnectionTruncated, match="without the peer's close"):
        end.core.receive_eof()
    assert end.core.deadline() is None


def test_the_end_during_the_handshake() -> None:
    with pytest.raises(HandshakeFailed, match="during the handshake"):
        alice().receive_eof()


# -- whom to talk to


def test_the_responder_refuses_a_stranger_without_saying_why() -> None:
    w = wire(alice(credentials=STRANGER)).pump()
    assert isinstance(w.right.error, IdentityRefused)
    assert "not signed by this site's authority" in str(w.right.error)
    assert w.right.error.hint == "enroll the node"
    assert isinstance(w.left.error, PeerRefused)
    assert str(w.left.error) == "the peer refused the handshake: handshake refused"
    assert names(w.right) == []


def test_the_initiator_refuses_a_stranger() -> None:
    w = wire(right=bob(credentials=STRANGER)).pump()
    assert isinstance(w.left.error, IdentityRefused)
    assert isinstance(w.right.error, PeerRefused)
    assert names(w.left) == []


def test_ones_own_certificate_is_refused() -> None:
    w = wire(alice(), bob(credentials=ALICE)).pump()
    assert isinstance(w.left.error, IdentityRefused)
    assert "own certificate" in str(w.left.error)


def test_a_certificate_of_several_nodes_is_no_reflection() -> None:
    shared = dataclasses.replace(ALICE, shared=True)
    w = wire(alice(credentials=shared), bob(credentials=shared)).pump()
    assert (w.left.error, w.right.error) == (None, None)
    assert names(w.left) == names(w.right) == ["/alice"]


def test_whoever_does_not_share_its_certificate_refuses_it_from_those_who_do() -> None:
    w = wire(alice(), bob(credentials=dataclasses.replace(ALICE, shared=True))).pump()
    assert isinstance(w.left.error, IdentityRefused)


def test_a_bug_in_verify_ends_the_connection() -> None:
    def broken(chain: tuple[bytes, ...], now: int) -> FakeIdentity:
        raise ZeroDivisionError

    w = wire()
    core = Connection[FakeIdentity].initiator(ALICE, broken, random=dice("x"), now=NOW)
    w.right.give(bytes(core.data_to_send()))
    with pytest.raises(ZeroDivisionError):
        core.receive_data(w.right.take(), NOW)
    assert core.state is ConnectionState.CLOSED
    assert core.data_to_send() == b""


# -- cipher suites


def test_the_initiator_tries_once_more_with_the_suite_of_the_responder() -> None:
    w = wire(alice(suites=(4, 6)), bob(suites=(6,))).pump()
    assert names(w.left) == ["/bob"]
    assert names(w.right) == ["/alice"]


def test_no_common_suite() -> None:
    w = wire(alice(suites=(4,)), bob(suites=(6,))).pump()
    assert isinstance(w.left.error, HandshakeFailed)
    assert "no cipher suite" in str(w.left.error)


def test_a_responder_answers_a_wrong_suite_once() -> None:
    flight = bytes(alice(suites=(4,)).data_to_send())
    core = bob()
    core.receive_data(flight, NOW)
    assert core.data_to_send() == frame(Frame.ERROR, encode_error(2, 6))
    with pytest.raises(HandshakeFailed):
        core.receive_data(flight[16:], NOW)


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


# -- plain peers


def test_a_plain_caller_hears_why() -> None:
    core = bob()
    request = b"\x0a\0\0\0" + b"\x06\0\0\0a=bcde"
    core.receive_data(request[:-1], NOW)
    assert core.state is ConnectionState.DRAINING
    with pytest.raises(PlainPeer):
        core.receive_data(request[-1:], NOW)
    assert core.data_to_send() == tcpros_refusal(REFUSAL)


def test_an_opening_that_is_not_accepted_hears_the_refusal() -> None:
    w = wire(alice(WireProtocol.HTTP), bob(accept=frozenset({WireProtocol.TCPROS}))).pump()
    assert isinstance(w.right.error, PlainPeer)
    assert isinstance(w.left.error, PlainPeer)
    assert "200 OK" in str(w.left.error)


def test_a_plain_node_answers() -> None:
    core = alice()
    with pytest.raises(PlainPeer, match="no topic or service name detected"):
        core.receive_data(tcpros_refusal("no topic or service name detected"), NOW)


def test_garbage_is_dropped_silently() -> None:
    core = bob()
    with pytest.raises(ProtocolViolation):
        core.receive_data(b"\xff" * 100, NOW)
    assert core.data_to_send() == b""


# -- the table


HANDSHAKE_STATES = (
    ConnectionState.WAIT_1,
    ConnectionState.WAIT_2,
    ConnectionState.WAIT_3,
    ConnectionState.WAIT_4,
)


@pytest.mark.parametrize(
    ("state", "kind"),
    [(state, kind) for state in HANDSHAKE_STATES for kind in Frame if (state, kind) not in TABLE],
)
def test_what_is_not_in_the_table_ends_the_connection(state: ConnectionState, kind: Frame) -> None:
    end = _in_state(state)
    end.give(frame(kind, b"\0" * 20))
    assert isinstance(end.error, ProtocolViolation)
    assert end.core.state is ConnectionState.CLOSED
    told = end.take()
    assert (told == frame(Frame.ERROR, encode_error(1, "handshake refused"))) == (
        state is not ConnectionState.WAIT_4
    )


@pytest.mark.parametrize("kind", [0, 1, 2, 7, 15])
def test_frames_that_an_open_connection_does_not_know(kind: int) -> None:
    w = joined()
    w.right.give(bytes([kind << 4, 0, 0, 20]) + bytes(20))
    assert isinstance(w.right.error, ProtocolViolation)
    assert w.right.take() == b""


def _in_state(state: ConnectionState) -> End:
    w = wire()
    if state is ConnectionState.WAIT_2:
        w.left.take()
        w.left.core.state = ConnectionState.WAIT_2
        return w.left
    if state is ConnectionState.WAIT_1:
        w.right.give(w.left.take()[:16])
        return w.right
    w.right.give(w.left.take())
    w.left.give(w.right.take())
    w.left.take()
    return w.right if state is ConnectionState.WAIT_3 else w.left


# -- time


def test_the_handshake_has_one_deadline() -> None:
    core = bob()
    assert core.deadline() == NOW + 5
    core.tick(NOW + 4)
    with pytest.raises(HandshakeTimeout):
        core.tick(NOW + 5)
    core.tick(NOW + 6)


def test_the_connection_ends_with_the_peers_certificate() -> None:
    w = joined(right=bob(limits=ChannelLimits(seconds=1 << 40)))
    assert w.right.core.deadline() == NOT_AFTER
    with pytest.raises(IdentityExpired):
        w.right.core.tick(NOT_AFTER)
    assert w.right.core.state is ConnectionState.CLOSED


def test_keys_are_renewed_by_time() -> None:
    w = joined(left=alice(limits=SMALL), right=bob(limits=SMALL))
    assert w.left.core.deadline() == NOW + 100
    w.left.core.tick(NOW + 100)
    assert w.left.take() == b""  # not used: nothing to renew
    w.left.core.send_unit(b"a")
    w.left.core.tick(NOW + 200)
    w.pump()
    w.left.core.send_unit(b"b")
    w.right.core.send_unit(b"c")
    assert w.pump().right.units == [b"a", b"b"]
    assert w.left.units == [b"c"]


def test_a_peer_that_does_not_follow_is_left() -> None:
    w = joined(left=alice(limits=SMALL), right=bob(limits=SMALL))
    w.left.core.send_unit(b"a")
    w.left.core.tick(NOW + 100)
    with pytest.raises(LimitExceeded):
        w.left.core.tick(NOW + 200)
    assert w.left.core.state is ConnectionState.CLOSED


def test_renewal_both_ways_and_one_way() -> None:
    w = joined(left=alice(limits=SMALL), right=bob(limits=SMALL))
    for count in range(50):
        w.left.core.send_unit(b"left %d" % count)
        if count % 3 == 0:
            w.right.core.send_unit(b"right %d" % count)
        w.pump()
    assert len(w.right.units) == 50
    assert len(w.left.units) == 17
    assert w.left.error is None
    assert w.right.error is None


def test_the_hard_stop_of_the_sender() -> None:
    w = joined(left=alice(limits=SMALL), right=bob(limits=SMALL))
    for _ in range(4 + 8):
        w.left.core.send_unit(b"x")
    with pytest.raises(LimitExceeded, match="does not follow"):
        w.left.core.send_unit(b"x")
    assert w.left.take() == b""
    assert w.left.core.state is ConnectionState.CLOSED


def test_the_hard_stop_of_the_receiver() -> None:
    w = joined(right=bob(limits=SMALL))
    for _ in range(9):
        w.left.core.send_unit(b"x")
        w.pump()
    assert isinstance(w.right.error, LimitExceeded)
    assert len(w.right.units) == 8


def test_a_forged_record_ends_the_connection_for_ever() -> None:
    w = joined()
    w.left.core.send_unit(b"x")
    record = w.left.take()
    w.right.give(record[:-1] + bytes([record[-1] ^ 1]))
    assert isinstance(w.right.error, RecordForged)
    assert w.right.core.receive_data(record, NOW) == []
    with pytest.raises(ChannelError):
        w.right.core.send_unit(b"y")
    assert w.right.take() == b""


def test_secrets_do_not_appear_in_representations() -> None:
    w: Wire = joined()
    session = w.left.core._session
    assert session is not None
    assert repr(session._epochs._exporter) == "Exporter(...)"
    with pytest.raises(HandshakeFailed):  # an open connection needs it no more
        _ = w.left.core._negotiation._edhoc.exporter


def test_the_short_way_for_small_units() -> None:
    w = joined(left=alice(limits=SMALL), right=bob(limits=SMALL))
    for count in range(4):
        record = w.left.core.seal_small(b"%d" % count)
        assert record is not None
        w.right.give(bytes(record))
    assert w.left.core.seal_small(b"a renewal is due") is None
    assert w.left.core.seal_small(b"") is None
    assert w.left.core.seal_small(b"x" * 100_000) is None
    w.left.core.send_unit(b"4")
    assert w.left.core.seal_small(b"something is queued") is None
    w.pump()
    assert w.right.units == [b"0", b"1", b"2", b"3", b"4"]
    w.left.core.close()
    assert w.left.core.seal_small(b"closed") is None


def test_what_was_put_back_goes_first() -> None:
    w = joined()
    record = w.left.core.seal_small(b"first")
    assert record is not None
    w.right.give(bytes(record[:10]))
    w.left.core.put_back(record[10:])
    w.left.core.put_back(b"")
    w.left.core.send_unit(b"second")
    w.pump()
    assert w.right.units == [b"first", b"second"]


def test_units_never_interleave() -> None:
    w = joined()
    records = w.left.core.seal_unit(b"x" * 600_000)
    w.right.give(bytes(next(records)))
    assert w.left.core.seal_small(b"y") is None
    with pytest.raises(ProtocolViolation, match="second unit"):
        w.left.core.send_unit(b"y")
    w.right.give(b"".join(records))
    w.left.core.send_unit(b"y")
    assert w.pump().right.units == [b"x" * 600_000, b"y"]


# -- certificates named by a hash


def met() -> tuple[KnownCertificates, KnownCertificates]:
    """What Alice and Bob know after a first handshake by value."""
    left, right = KnownCertificates(), KnownCertificates()
    wire(alice(known=left), bob(known=right)).pump()
    return left, right


def test_the_second_handshake_names_certificates_by_their_hashes() -> None:
    left, right = met()
    w = wire(alice(known=left, request_x5t=True), bob(known=right)).pump()
    assert names(w.left) == ["/bob"]
    assert names(w.right) == ["/alice"]
    assert sum(map(len, w.left.sent + w.right.sent)) <= 300
    w.left.core.send_unit(b"x")
    assert w.pump().right.units == [b"x"]


def test_nothing_is_sent_before_a_named_certificate_is_accepted() -> None:
    left, right = met()
    w = wire(alice(known=left, request_x5t=True), bob(known=right))
    w.right.give(w.left.take())
    w.left.give(w.right.take())
    with pytest.raises(ChannelClosed):
        w.left.core.send_unit(b"early")
    assert w.left.core.seal_small(b"early") is None
    assert names(w.pump().left) == ["/bob"]


def test_a_responder_that_forgot_says_so() -> None:
    left, _ = met()
    w = wire(alice(known=left, request_x5t=True), bob(known=KnownCertificates())).pump()
    assert isinstance(w.right.error, PeerCredentialUnknown)
    assert isinstance(w.left.error, OwnCredentialUnknown)
    left.forget_introductions()
    assert names(wire(alice(known=left), bob(known=KnownCertificates())).pump().right) == ["/alice"]


def test_an_initiator_that_does_not_know_the_name_says_so() -> None:
    _, right = met()
    w = wire(alice(known=KnownCertificates(), request_x5t=True), bob(known=right)).pump()
    assert isinstance(w.left.error, PeerCredentialUnknown)
    assert isinstance(w.right.error, OwnCredentialUnknown)
    assert names(w.left) == []


def test_a_responder_without_a_memory_gets_the_certificate() -> None:
    """Alice was introduced to it, but it answers by value: it may not know references at all."""
    left, _ = met()
    assert names(wire(alice(known=left, request_x5t=True)).pump().right) == ["/alice"]


def test_only_verified_certificates_are_remembered() -> None:
    known = KnownCertificates()
    wire(alice(credentials=STRANGER), bob(known=known)).pump()
    assert len(known) == 0


# -- the other suites


@pytest.mark.parametrize("suites", [(-24,), (-24, 6)])
def test_the_hybrid_suite(suites: tuple[int, ...]) -> None:
    w = wire(alice(suites=suites), bob(suites=suites)).pump()
    assert w.right.core._negotiation._edhoc.suite.number == -24
    w.left.core.send_unit(b"x")
    assert w.pump().right.units == [b"x"]


def test_who_requires_the_hybrid_suite_talks_to_nobody_else() -> None:
    w = wire(alice(suites=(6,)), bob(suites=(-24,))).pump()
    assert isinstance(w.left.error, HandshakeFailed)
    assert names(w.right) == []
    assert names(wire(alice(suites=(-24, 6)), bob(suites=(6,))).pump().right) == ["/alice"]
    assert names(wire(alice(suites=(6,)), bob(suites=(-24, 6))).pump().right) == ["/alice"]


def test_the_socket_writes_into_the_buffer_of_the_connection() -> None:
    left, right = alice(), bob()
    queued = [left.has_data_to_send]
    flight = left.data_to_send()
    queued.append(left.has_data_to_send)
    assert queued == [True, False]
    right.get_buffer()[: len(flight)] = flight
    assert right.buffer_updated(len(flight), NOW) == []
    assert right.has_data_to_send
    assert left.unit_limit == ChannelLimits().unit


def test_what_is_abandoned_says_and_seals_nothing() -> None:
    """A forked process: its parent goes on with these keys and counters."""
    left = joined().left.core
    left.abandon()
    left.close()
    assert not left.has_data_to_send
    assert left.seal_small(b"x") is None
    with pytest.raises(ChannelClosed):
        left.send_unit(b"x")

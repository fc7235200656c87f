"""What waits for a connection, with connections that only note it."""

from threading import Thread
from types import SimpleNamespace

import pytest

from rossec.errors import ChannelClosed, ServiceRefused
from tests.support.rosconnection import connection
from tests.support.witness import until

pytestmark = pytest.mark.ros

outbox = pytest.importorskip("rossec.inprocess.send_queue")
exceptions = pytest.importorskip("rospy.exceptions")


def test_a_whole_message_a_treated_one_and_many() -> None:
    made = connection()
    outbox.write(made, [b"\4\0\0\0abcd"])
    outbox.write(made, [b"\1\0\0\0a", b"\1\0\0\0b"])
    outbox.write_data(made, (b"\2\0\0\0", memoryview(b"xy")))
    outbox.write(made, [b"\1\0\0\0a", (b"\1\0\0\0", b"c")])
    assert made.socket.units == [
        b"\4\0\0\0abcd", b"\1\0\0\0a\1\0\0\0b", b"\2\0\0\0xy", b"\1\0\0\0a\1\0\0\0c",
    ]  # fmt: skip
    assert (made.stat_num_msg, made.stat_bytes) == (6, 34)


def test_a_call_over_a_connection_that_was_cut_fails_as_services_do() -> None:
    tcpros = pytest.importorskip("rospy.impl.tcpros_service")
    service = pytest.importorskip("rospy.service")
    for protocol, expected in (
        (None, exceptions.TransportTerminated),
        (object.__new__(tcpros.TCPROSServiceClient), service.ServiceException),
    ):
        made = connection()
        made.protocol = protocol
        made.socket.error = ChannelClosed("cut")
        with pytest.raises(expected, match="cut"):
            outbox.write_data(made, b"\0\0\0\0")
        assert made.done


def test_a_large_message_follows_its_length() -> None:
    made = connection()
    message = len(bytes(300_000)).to_bytes(4, "little") + bytes(300_000)
    outbox.write(made, [message])
    assert made.socket.units == [message[:4], message[4:]]


def test_a_connection_that_ended_is_closed() -> None:
    made = connection()
    made.socket.error = ChannelClosed("gone")
    with pytest.raises(exceptions.TransportTerminated, match="gone"):
        outbox.write(made, [b"x"])
    assert made.done
    with pytest.raises(exceptions.TransportTerminated, match="connection closed"):
        outbox.write(made, [b"x"])


async def test_what_waits_goes_out_as_one() -> None:
    made = connection()
    box = outbox.SendQueue(made, 0)
    assert box.endpoint_id == "/x"
    assert box.socket is made.socket
    with pytest.raises(AttributeError):
        _ = box.__nothing__
    made.socket.gate.clear()
    box.write_data(b"1")
    await until(lambda: not box._queue)
    for number in range(2, 6):
        box.write_data(b"%d" % number)
    made.socket.gate.set()
    await until(lambda: b"".join(made.socket.units) == b"12345")
    assert made.socket.units == [b"1", b"2345"]
    made.socket.gate.clear()
    large = bytes(200_000)
    for _ in range(4):
        box.write_data(large)
    made.socket.gate.set()
    await until(lambda: made.stat_num_msg == 9)
    made.socket.error = ChannelClosed("gone")
    box.write_data(b"x")
    await until(lambda: box._error is not None)
    with pytest.raises(exceptions.TransportTerminated):
        box.write_data(b"y")
    box._thread.join(30)
    assert not box._thread.is_alive()


async def test_a_message_after_a_pause_does_not_wait_for_the_sender(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(outbox, "_PAUSE", 0.0)
    made = connection()
    made.socket.at_once = True
    box = outbox.SendQueue(made, 0)
    await until(lambda: box._idle)
    box.write_data(b"1")
    assert made.socket.units == [b"1"], "in this thread"
    assert (made.stat_num_msg, made.stat_bytes) == (1, 1)
    made.socket.unsent = True
    box.write_data(b"2")
    await until(lambda: made.socket.units == [b"1", b"2", b""])
    await until(lambda: made.stat_num_msg == 2)
    made.socket.unsent = False
    await until(lambda: box._idle)
    for message in (bytes(20_000), (b"a", b"b")):
        box.write_data(message)
        await until(lambda: box._idle and not box._queue)
    assert made.socket.units[3:] == [bytes(20_000), b"ab"]
    made.socket.error = ChannelClosed("gone")
    with pytest.raises(exceptions.TransportTerminated, match="gone"):
        box.write_data(b"x")
    box._thread.join(30)


async def test_a_full_queue_drops_the_oldest() -> None:
    made = connection()
    box = outbox.SendQueue(made, 2)
    made.socket.gate.clear()
    box.write_data(b"1")
    await until(lambda: not box._queue)
    for number in range(2, 6):
        box.write_data(b"%d" % number)
    made.socket.gate.set()
    await until(lambda: b"".join(made.socket.units) == b"145")
    made.close()
    box._thread.join(30)


@pytest.mark.parametrize("persistent", [True, False])
def test_a_call_that_is_not_allowed_is_not_sent(persistent: bool) -> None:
    service = pytest.importorskip("rospy.service")
    made = connection()
    made.protocol = SimpleNamespace(headers={"persistent": "1"} if persistent else {})
    made.write_buff.write(b"the request")

    def refuse(_: bytes) -> None:
        raise ServiceRefused("not allowed")

    made.socket.exchange = SimpleNamespace(outgoing=refuse)
    sock = made.socket
    with pytest.raises(service.ServiceException, match="rossec: not allowed"):
        outbox.write_data(made, b"the request")
    assert sock.units == []
    assert made.done != persistent
    if persistent:
        assert made.write_buff.getvalue() == b"", "else it would go before the next one"
        made.socket.exchange = SimpleNamespace(outgoing=lambda data: (data[:1], data[1:]))
        made.protocol = SimpleNamespace(headers={})
        outbox.write_data(made, b"allowed")
        assert b"".join(sock.units) == b"allowed"


async def test_a_connection_is_closed_with_no_lock_held(monkeypatch: pytest.MonkeyPatch) -> None:
    """rospy closes one under the lock of its topic, where this side then waits for the outbox."""
    monkeypatch.setattr(outbox, "_PAUSE", -1.0)  # each message is one after a pause
    made = connection()
    made.socket.at_once = True
    box = outbox.SendQueue(made, 0)
    await until(lambda: box._idle)
    closed, waits = made.close, list[bool]()

    def close() -> None:
        other = Thread(target=box._closed, args=(None,), daemon=True)
        other.start()
        other.join(timeout=10)
        waits.append(other.is_alive())
        closed()

    made.close = close
    made.socket.error = ChannelClosed("gone")
    with pytest.raises(exceptions.TransportTerminated, match="gone"):
        box.write_data(b"x")
    assert (made.done, waits) == (True, [False])
    box._thread.join(timeout=30)

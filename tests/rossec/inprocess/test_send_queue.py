"""Queues of messages, with transports that only record them."""

from threading import Thread
from types import SimpleNamespace

import pytest

from rossec.errors import ChannelClosed, ServiceRefused
from tests.support.rosconnection import transport
from tests.support.witness import until

pytestmark = pytest.mark.ros

send_queue = pytest.importorskip("rossec.inprocess.publishing")
exceptions = pytest.importorskip("rospy.exceptions")


def test_a_whole_message_a_filtered_one_and_many() -> None:
    made = transport()
    send_queue.write(made, [b"\4\0\0\0abcd"])
    send_queue.write(made, [b"\1\0\0\0a", b"\1\0\0\0b"])
    send_queue.write_data(made, (b"\2\0\0\0", memoryview(b"xy")))
    send_queue.write(made, [b"\1\0\0\0a", (b"\1\0\0\0", b"c")])
    assert made.socket.units == [b"\4\0\0\0abcd", b"\1\0\0\0a\1\0\0\0b", b"\2\0\0\0xy", b"\1\0\0\0a\1\0\0\0c"]
    assert (made.stat_num_msg, made.stat_bytes) == (6, 34)


def test_a_call_over_a_closed_connection_fails_as_services_do() -> None:
    tcpros = pytest.importorskip("rospy.impl.tcpros_service")
    service = pytest.importorskip("rospy.service")
    for protocol, expected in (
        (None, exceptions.TransportTerminated),
        (object.__new__(tcpros.TCPROSServiceClient), service.ServiceException),
    ):
        made = transport()
        made.protocol = protocol
        made.socket.error = ChannelClosed("closed")
        with pytest.raises(expected, match="closed"):
            send_queue.write_data(made, b"\0\0\0\0")
        assert made.done


def test_a_large_message_follows_its_length() -> None:
    made = transport()
    message = len(bytes(300_000)).to_bytes(4, "little") + bytes(300_000)
    send_queue.write(made, [message])
    assert made.socket.units == [message[:4], message[4:]]


def test_a_connection_that_ended_is_closed() -> None:
    made = transport()
    made.socket.error = ChannelClosed("gone")
    with pytest.raises(exceptions.TransportTerminated, match="gone"):
        send_queue.write(made, [b"x"])
    assert made.done
    with pytest.raises(exceptions.TransportTerminated, match="connection closed"):
        send_queue.write(made, [b"x"])


async def test_queued_messages_are_sent_as_one_unit() -> None:
    made = transport()
    queue = send_queue.SendQueue(made, 0)
    assert queue.endpoint_id == "/x"
    assert queue.socket is made.socket
    assert isinstance(type(queue).socket, property), "read for each message: not by __getattr__"
    with pytest.raises(AttributeError):
        _ = queue.__nothing__
    made.socket.gate.clear()
    queue.write_data(b"1")
    await until(lambda: not queue._queue)
    for number in range(2, 6):
        queue.write_data(b"%d" % number)
    made.socket.gate.set()
    await until(lambda: b"".join(made.socket.units) == b"12345")
    assert made.socket.units == [b"1", b"2345"]
    made.socket.gate.clear()
    large = bytes(200_000)
    for _ in range(4):
        queue.write_data(large)
    made.socket.gate.set()
    await until(lambda: made.stat_num_msg == 9)
    made.socket.error = ChannelClosed("gone")
    queue.write_data(b"x")
    await until(lambda: queue._error is not None)
    kept = queue._error
    assert kept is not None
    assert (kept.__traceback__, kept.__cause__, kept.__context__) == (None, None, None)
    with pytest.raises(exceptions.TransportTerminated):
        queue.write_data(b"y")
    queue._thread.join(30)
    assert not queue._thread.is_alive()


async def test_a_message_after_a_pause_does_not_wait_for_the_sender(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(send_queue, "PAUSE", 0.0)
    made = transport()
    made.socket.at_once = True
    queue = send_queue.SendQueue(made, 0)
    await until(lambda: queue._idle)
    queue.write_data(b"1")
    assert made.socket.units == [b"1"], "in this thread"
    assert (made.stat_num_msg, made.stat_bytes) == (1, 1)
    made.socket.unsent = True
    queue.write_data(b"2")
    await until(lambda: made.socket.units == [b"1", b"2", b""])
    await until(lambda: made.stat_num_msg == 2)
    made.socket.unsent = False
    await until(lambda: queue._idle)
    for message in (bytes(20_000), (b"a", b"b")):
        queue.write_data(message)
        await until(lambda: queue._idle and not queue._queue)
    assert made.socket.units[3:] == [bytes(20_000), b"ab"]
    made.socket.error = ChannelClosed("gone")
    with pytest.raises(exceptions.TransportTerminated, match="gone"):
        queue.write_data(b"x")
    queue._thread.join(30)


async def test_a_full_queue_drops_the_oldest() -> None:
    made = transport()
    queue = send_queue.SendQueue(made, 2)
    made.socket.gate.clear()
    queue.write_data(b"1")
    await until(lambda: not queue._queue)
    for number in range(2, 6):
        queue.write_data(b"%d" % number)
    made.socket.gate.set()
    await until(lambda: b"".join(made.socket.units) == b"145")
    made.close()
    queue._thread.join(30)


@pytest.mark.parametrize("persistent", [True, False])
def test_a_call_that_is_not_allowed_is_not_sent(persistent: bool) -> None:
    service = pytest.importorskip("rospy.service")
    made = transport()
    made.protocol = SimpleNamespace(headers={"persistent": "1"} if persistent else {})
    made.write_buff.write(b"the request")

    def refuse(_: bytes) -> None:
        raise ServiceRefused("not allowed")

    made.socket.service_filter = SimpleNamespace(outgoing=refuse)
    sock = made.socket
    with pytest.raises(service.ServiceException, match="rossec: not allowed"):
        send_queue.write_data(made, b"the request")
    assert sock.units == []
    assert made.done != persistent
    if persistent:
        assert made.write_buff.getvalue() == b"", "else it would be sent before the next one"
        made.socket.service_filter = SimpleNamespace(outgoing=lambda data: (data[:1], data[1:]))
        made.protocol = SimpleNamespace(headers={})
        send_queue.write_data(made, b"allowed")
        assert b"".join(sock.units) == b"allowed"


async def test_a_connection_is_closed_with_no_lock_held(monkeypatch: pytest.MonkeyPatch) -> None:
    """rospy closes one under the lock of its topic, where this side then waits for the queue."""
    monkeypatch.setattr(send_queue, "PAUSE", -1.0)  # each message is one after a pause
    made = transport()
    made.socket.at_once = True
    queue = send_queue.SendQueue(made, 0)
    await until(lambda: queue._idle)
    closed, waits = made.close, list[bool]()

    def close() -> None:
        other = Thread(target=queue._closed, args=(None,), daemon=True)
        other.start()
        other.join(timeout=10)
        waits.append(other.is_alive())
        closed()

    made.close = close
    made.socket.error = ChannelClosed("gone")
    with pytest.raises(exceptions.TransportTerminated, match="gone"):
        queue.write_data(b"x")
    assert (made.done, waits) == (True, [False])
    queue._thread.join(timeout=30)

"""What goes to whom, with connections that only note it."""

import threading
from types import SimpleNamespace
from typing import Any

import pytest

from rossec.errors import ChannelClosed
from tests.support.witness import until

pytestmark = pytest.mark.ros

publishing = pytest.importorskip("rossec.inprocess.publishing")
exceptions = pytest.importorskip("rospy.exceptions")


class Sock:
    def __init__(self, link: object = None) -> None:
        self.link = link
        self.units: list[bytes] = []
        self.gate = threading.Event()
        self.gate.set()
        self.error: Exception | None = None
        self.at_once = False
        self.unsent = False

    def send_now(self, data: bytes) -> bool:
        if self.at_once:
            self.send_unit(data)
        return self.at_once

    def send_unit(self, *pieces: Any) -> None:
        self.gate.wait(30)
        if self.error is not None:
            raise self.error
        self.units.append(b"".join(map(bytes, pieces)))


def connection(link: object = None) -> Any:
    made: Any = SimpleNamespace(
        socket=Sock(link),
        protocol=None,
        done=False,
        stat_bytes=0,
        stat_num_msg=0,
        endpoint_id="/x",
        callback=None,
    )

    def close() -> None:
        made.done = True
        if made.callback is not None:
            made.callback(made)

    made.close = close
    made.set_cleanup_callback = lambda callback: setattr(made, "callback", callback)
    return made


def test_a_whole_message_a_treated_one_and_many() -> None:
    made = connection()
    publishing.write(made, [b"\4\0\0\0abcd"])
    publishing.write(made, [b"\1\0\0\0a", b"\1\0\0\0b"])
    publishing.write_data(made, (b"\2\0\0\0", memoryview(b"xy")))
    publishing.write(made, [b"\1\0\0\0a", (b"\1\0\0\0", b"c")])
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
            publishing.write_data(made, b"\0\0\0\0")
        assert made.done


def test_a_large_message_follows_its_length() -> None:
    made = connection()
    message = len(bytes(300_000)).to_bytes(4, "little") + bytes(300_000)
    publishing.write(made, [message])
    assert made.socket.units == [message[:4], message[4:]]


def test_a_connection_that_ended_is_closed() -> None:
    made = connection()
    made.socket.error = ChannelClosed("gone")
    with pytest.raises(exceptions.TransportTerminated, match="gone"):
        publishing.write(made, [b"x"])
    assert made.done
    with pytest.raises(exceptions.TransportTerminated, match="connection closed"):
        publishing.write(made, [b"x"])


def test_nothing_for_a_connection_without_a_right() -> None:
    bare, ended = connection(), connection(SimpleNamespace(ends=0, guard=None))
    noted: list[bytes] = []
    for made in (bare, ended):
        made.write_data = noted.append
    assert publishing._offer("/x", b"\1\0\0\0a", [bare, ended]) == []
    assert noted == []
    broken = SimpleNamespace(socket=None)
    assert publishing._offer("/x", b"\1\0\0\0a", [broken]) == [broken]


async def test_what_waits_goes_out_as_one() -> None:
    made = connection()
    outbox = publishing.Outbox(made, 0)
    assert outbox.endpoint_id == "/x"
    with pytest.raises(AttributeError):
        _ = outbox.__nothing__
    made.socket.gate.clear()
    outbox.write_data(b"1")
    await until(lambda: not outbox._queue)
    for number in range(2, 6):
        outbox.write_data(b"%d" % number)
    made.socket.gate.set()
    await until(lambda: b"".join(made.socket.units) == b"12345")
    assert made.socket.units == [b"1", b"2345"]
    made.socket.gate.clear()
    large = bytes(200_000)
    for _ in range(4):
        outbox.write_data(large)
    made.socket.gate.set()
    await until(lambda: made.stat_num_msg == 9)
    made.socket.error = ChannelClosed("gone")
    outbox.write_data(b"x")
    await until(lambda: outbox._error is not None)
    with pytest.raises(exceptions.TransportTerminated):
        outbox.write_data(b"y")
    outbox._thread.join(30)
    assert not outbox._thread.is_alive()


async def test_a_message_after_a_pause_does_not_wait_for_the_sender(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(publishing, "_PAUSE", 0.0)
    made = connection()
    made.socket.at_once = True
    outbox = publishing.Outbox(made, 0)
    await until(lambda: outbox._idle)
    outbox.write_data(b"1")
    assert made.socket.units == [b"1"], "in this thread"
    assert (made.stat_num_msg, made.stat_bytes) == (1, 1)
    made.socket.unsent = True
    outbox.write_data(b"2")
    await until(lambda: made.socket.units == [b"1", b"2", b""])
    await until(lambda: made.stat_num_msg == 2)
    made.socket.unsent = False
    await until(lambda: outbox._idle)
    for message in (bytes(20_000), (b"a", b"b")):
        outbox.write_data(message)
        await until(lambda: outbox._idle and not outbox._queue)
    assert made.socket.units[3:] == [bytes(20_000), b"ab"]
    made.socket.error = ChannelClosed("gone")
    with pytest.raises(exceptions.TransportTerminated, match="gone"):
        outbox.write_data(b"x")
    outbox._thread.join(30)


async def test_a_full_queue_drops_the_oldest() -> None:
    made = connection()
    outbox = publishing.Outbox(made, 2)
    made.socket.gate.clear()
    outbox.write_data(b"1")
    await until(lambda: not outbox._queue)
    for number in range(2, 6):
        outbox.write_data(b"%d" % number)
    made.socket.gate.set()
    await until(lambda: b"".join(made.socket.units) == b"145")
    made.close()
    outbox._thread.join(30)


class Buffer:
    """As rospy's topics have one."""

    def __init__(self) -> None:
        from io import BytesIO

        self.inner = BytesIO()

    def __getattr__(self, name: str) -> Any:
        return getattr(self.inner, name)


def topic(**changes: Any) -> Any:
    made: Any = SimpleNamespace(
        closed=False, is_latch=True, latch=None, connections=[], buff=Buffer(), seq=0,
        message_data_sent=0, resolved_name="/x", has_connections=lambda: bool(made.connections),
    )  # fmt: skip
    for name, value in changes.items():
        setattr(made, name, value)
    return made


def message(data: str = "hello") -> Any:
    return pytest.importorskip("std_msgs.msg").String(data)


def test_publishing_is_rospys() -> None:
    made = topic()
    assert publishing.publish(made, message()) is False
    assert made.latch.data == "hello"
    dead: Any = SimpleNamespace(socket=None, close=lambda: made.connections.remove(dead))
    made.connections = [dead]
    assert publishing.publish(made, message()) is None
    assert made.connections == []
    assert made.message_data_sent == 13
    one = SimpleNamespace(socket=None, close=lambda: None)
    made.connections = [one]
    publishing.publish(made, message(), connection_override=one)
    made.closed = True
    with pytest.raises(exceptions.ROSException, match="closed topic"):
        publishing.publish(made, message())


def test_a_topic_closed_meanwhile_says_so() -> None:
    made = topic(connections=[connection()])
    made.buff.inner.close()
    with pytest.raises(ValueError, match="closed file"):
        publishing.publish(made, message())

    def close() -> bool:
        made.closed = True
        return True

    made.has_connections = close
    with pytest.raises(exceptions.ROSException, match=r"during publish"):
        publishing.publish(made, message())

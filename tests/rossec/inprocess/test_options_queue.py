"""A subscriber of rospy with options: thinned out, the newest only, deflated once for all."""

import socket
import struct
from typing import Any

import pytest

from rossec.channel.tuning import UNSENT
from rossec.participant import delivery_options
from rossec.participant.delivery_options import LARGE, NO_OPTIONS, DeliveryOptions, deflated
from tests.support.rosconnection import transport
from tests.support.witness import until

pytestmark = pytest.mark.ros

send_queue = pytest.importorskip("rossec.inprocess.publishing")
publishing = pytest.importorskip("rossec.inprocess.publishing")


def connection(options: DeliveryOptions) -> Any:
    made = transport()
    made.socket.options = options
    made.socket.set = []
    made.socket.setsockopt = lambda *option: made.socket.set.append(option)
    return made


def framed(content: bytes) -> bytes:
    return struct.pack("<I", len(content)) + content


def sent(made: Any) -> bytes:
    return b"".join(made.socket.units)


def test_only_a_subscriber_with_options_has_such_a_queue() -> None:
    for options, kind in ((NO_OPTIONS, send_queue.SendQueue), (DeliveryOptions(5), publishing.OptionsQueue)):
        made = connection(options)
        queue = publishing.queue_for(made, 3)
        made.close()
        queue._thread.join(30)
        assert type(queue) is kind
        assert made.socket.set == []


async def test_the_rate_takes_messages_away(monkeypatch: pytest.MonkeyPatch) -> None:
    made = connection(DeliveryOptions(1.0))
    queue = publishing.queue_for(made, 0)
    now = 0.0
    monkeypatch.setattr(publishing.time, "monotonic", lambda: now)
    for number in range(40):
        now = number * 0.1
        queue.write_data(framed(b"%d" % number))
    monkeypatch.undo()
    expected = b"".join(map(framed, (b"0", b"1", b"10", b"20", b"30")))
    await until(lambda: sent(made) == expected)
    assert made.stat_num_msg == 5
    made.close()


@pytest.mark.parametrize("newest", [True, False])
async def test_of_what_waits_only_the_newest_is_sent(newest: bool) -> None:
    made = connection(DeliveryOptions(newest=newest, deflate=not newest))
    queue = publishing.queue_for(made, 100)
    made.socket.gate.clear()
    queue.write_data(framed(b"first"))
    await until(lambda: not queue._waiting)
    for number in range(50):
        queue.write_data((b"\2\0\0\0", b"%02d" % number))
    made.socket.gate.set()
    if newest:
        await until(lambda: sent(made) == framed(b"first") + framed(b"49"))
        assert made.socket.set == [(socket.IPPROTO_TCP, socket.TCP_NOTSENT_LOWAT, UNSENT)]
    else:
        every = b"".join(framed(b"\0%02d" % number) for number in range(50))
        await until(lambda: sent(made) == framed(b"\0first") + every)
    made.close()


@pytest.mark.parametrize("size", [0, 10, 1000, LARGE - 2])
async def test_a_message_is_deflated_once_for_all(size: int, monkeypatch: pytest.MonkeyPatch) -> None:
    calls = []

    def count(pieces: Any) -> bytes:
        calls.append(pieces)
        return deflated(pieces)

    monkeypatch.setattr(delivery_options, "deflated", count)
    many = [connection(DeliveryOptions(deflate=True)) for _ in range(3)]
    queues = [publishing.queue_for(made, 10) for made in many]
    for made in many:
        made.socket.gate.clear()
    content = bytes(size)
    whole, filtered = framed(content), (struct.pack("<I", size + 1), content, b"x")
    for data in (whole, filtered):
        for queue in queues:
            queue.write_data(data)
    for made in many:
        made.socket.gate.set()
    expected = framed(deflated([content])) + framed(deflated([content, b"x"]))
    await until(lambda: [sent(made) for made in many] == [expected] * 3)
    assert len(calls) == 2
    for made in many:
        made.close()


async def test_an_error_is_raised_by_the_next_call() -> None:
    exceptions = pytest.importorskip("rospy.exceptions")
    made = connection(DeliveryOptions(newest=True))
    queue = publishing.queue_for(made, 1)
    made.socket.error = OSError("gone")
    queue.write_data(framed(b"one"))
    await until(lambda: queue._error is not None)
    with pytest.raises(exceptions.TransportTerminated, match="gone"):
        queue.write_data(framed(b"two"))

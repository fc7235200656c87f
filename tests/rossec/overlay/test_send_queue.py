"""Messages are sent at once, or by a thread while that takes long; never out of order."""

import threading
import time

import pytest

from rossec.overlay import zenoh_carrier as send_queue_module
from rossec.overlay.zenoh_carrier import MOST_WAITING, CarrierQueue


class Uplink:
    """Sends at once, or only once it is `free`."""

    def __init__(self) -> None:
        self.sent: list[bytes] = []
        self.threads: set[int] = set()
        self.free = threading.Event()
        self.free.set()
        self.slow = False

    def send(self, _key: str, data: bytes) -> None:
        if self.slow:
            time.sleep(2 * send_queue_module.SLOW)
        if threading.current_thread() is not threading.main_thread():
            assert self.free.wait(20)
        self.threads.add(threading.get_ident())
        self.sent.append(data)

    def wait_for(self, count: int) -> None:
        until = time.monotonic() + 20
        while len(self.sent) < count:
            assert time.monotonic() < until
            time.sleep(0.001)


def test_a_quick_message_is_sent_by_the_caller() -> None:
    uplink = Uplink()
    send_queue = CarrierQueue(uplink.send)
    for each in (b"1", b"2"):
        send_queue.put("key", each)
    assert uplink.sent == [b"1", b"2"]
    assert uplink.threads == {threading.get_ident()}
    send_queue.close()


def test_after_a_slow_message_a_thread_sends_in_order() -> None:
    uplink = Uplink()
    send_queue = CarrierQueue(uplink.send)
    uplink.slow = True
    send_queue.put("key", b"0")
    uplink.slow = False
    uplink.free.clear()
    for each in range(1, 20):
        send_queue.put("key", b"%d" % each)
    assert uplink.sent == [b"0"]  # the caller does not wait for the rest
    uplink.free.set()
    uplink.wait_for(20)
    assert uplink.sent == [b"%d" % each for each in range(20)]
    send_queue.close()


def test_once_it_is_quick_again_the_caller_sends(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(send_queue_module, "CALM", 0.05)
    uplink = Uplink()
    send_queue = CarrierQueue(uplink.send)
    uplink.slow = True
    send_queue.put("key", b"slow")
    uplink.slow = False
    send_queue.put("key", b"by the thread")
    uplink.wait_for(2)
    time.sleep(0.06)
    uplink.threads.clear()
    while not uplink.threads:  # the thread has yet to note that nothing waits
        send_queue.put("key", b"again")
        if uplink.threads == {threading.get_ident()}:
            break
        uplink.threads.clear()
    assert uplink.threads == {threading.get_ident()}
    send_queue.close()


def test_what_waits_is_bounded() -> None:
    uplink = Uplink()
    send_queue = CarrierQueue(uplink.send)
    uplink.slow = True
    send_queue.put("key", b"")
    uplink.slow = False
    uplink.free.clear()
    piece = bytes(MOST_WAITING // 4)
    for _ in range(8):
        send_queue.put("key", piece)
    uplink.free.set()
    uplink.wait_for(5)
    time.sleep(0.02)
    assert len(uplink.sent) == 5
    send_queue.close()


def test_nothing_is_sent_after_the_close() -> None:
    uplink = Uplink()
    send_queue = CarrierQueue(uplink.send)
    uplink.slow = True
    send_queue.put("key", b"first")
    send_queue.close()
    send_queue.put("key", b"late")
    assert uplink.sent == [b"first"]

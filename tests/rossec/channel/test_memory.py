"""What an open connection holds while nothing happens, in objects that Python counts."""

import gc
import tracemalloc
from sys import getrefcount

from tests.support.wire import NOW, alice, bob, receive, renews, wire

ENDS = 200
MOST = 2500  # bytes of one end: 2.0 kB, and what tests beside this one change


def opened() -> list[object]:
    w = wire(alice(renews=renews), bob(renews=renews)).pump()
    for sender, receiver in ((w.left, w.right), (w.right, w.left)):
        sender.core.send_unit(bytes(64))
        receive(receiver.core, sender.core.data_to_send(), NOW)
    return [w.left.core, w.right.core]


def test_an_idle_connection_is_small() -> None:
    held = [opened() for _ in range(3)]  # imports, tables and the like
    gc.collect()
    tracemalloc.start()
    try:
        before, _ = tracemalloc.get_traced_memory()
        held += [opened() for _ in range(ENDS // 2)]
        gc.collect()
        after, _ = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert (after - before) / ENDS < MOST


def test_a_unit_that_was_delivered_is_not_kept() -> None:
    w = wire(alice(), bob()).pump()
    w.left.core.send_unit(bytes(range(64)))
    (event,) = receive(w.right.core, w.left.core.data_to_send(), NOW)
    assert getrefcount(event) == 2  # `event`, and the argument

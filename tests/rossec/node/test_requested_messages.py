"""What a subscriber does for its options by itself, and what it takes from a publisher."""

import asyncio
import struct
import zlib

import pytest

from rossec.errors import ConnectionHeaderRefused, WireError
from rossec.node import subscriber as module
from rossec.node.subscriber import RequestedMessages, requested_messages
from rossec.participant.delivery_options import LARGE, NO_OPTIONS, DeliveryOptions, deflated

LIMIT = 1 << 20
ALL = DeliveryOptions(5, newest=True, deflate=True)


def of(asked: DeliveryOptions, taken: DeliveryOptions) -> RequestedMessages:
    found = requested_messages(asked, taken.fields, LIMIT)
    assert found is not None
    return found


def test_nothing_is_done_where_nothing_is_left_to_do() -> None:
    assert requested_messages(NO_OPTIONS, {}, LIMIT) is None
    assert requested_messages(DeliveryOptions(5, newest=True), DeliveryOptions(5).fields, LIMIT) is None
    assert requested_messages(DeliveryOptions(newest=True), {}, LIMIT) is None
    with pytest.raises(ConnectionHeaderRefused, match="not asked to"):
        requested_messages(DeliveryOptions(5), DeliveryOptions(5, deflate=True).fields, LIMIT)


async def test_an_older_publishers_messages_come_as_they_are_and_are_thinned_out(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    now = 0.0
    monkeypatch.setattr(module, "monotonic", lambda: now)
    messages = of(ALL, NO_OPTIONS)
    assert await messages.inflated(b"\1as it is") == b"\1as it is"
    passed = 0
    for number in range(100):
        now = number * 0.02
        passed += messages.admits()
    assert passed == 11


async def test_a_publisher_that_takes_the_rate_is_not_thinned_out_again() -> None:
    messages = of(ALL, ALL)
    assert all(messages.admits() for _ in range(100))


@pytest.mark.parametrize("size", [0, 10, LARGE - 1, LARGE, LIMIT])
async def test_messages_are_inflated(size: int) -> None:
    assert await of(ALL, ALL).inflated(deflated([bytes(size)])) == bytes(size)


@pytest.mark.parametrize("size", [LIMIT + 1, 1 << 31])
async def test_a_message_beyond_the_limit_is_refused(size: int) -> None:
    engine = zlib.compressobj(9, zlib.DEFLATED, -15)
    bomb = b"\1" + struct.pack("<I", size) + engine.compress(bytes(9)) + engine.flush()
    with pytest.raises(WireError, match=f"at most {LIMIT} allowed"):
        await of(ALL, ALL).inflated(bomb)


async def test_thousands_of_small_bombs_leave_the_loop_its_turns() -> None:
    messages, small = of(ALL, ALL), deflated([bytes(LARGE // 2)])
    turns = 0

    async def count() -> None:
        nonlocal turns
        while True:
            turns += 1
            await asyncio.sleep(0)

    counting = asyncio.ensure_future(count())
    for _ in range(100):
        await messages.inflated(small)
    counting.cancel()
    assert turns >= 49

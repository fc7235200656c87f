"""Memory is used again only where nobody can see it."""

from collections import deque
from io import BytesIO

from rossec.inprocess.buffer_pool import BufferPool


def handed_out(content: bytes) -> tuple[BytesIO, bytes]:
    buffer = BytesIO()
    buffer.write(content)
    return buffer, buffer.getvalue()


def test_what_nobody_holds_is_written_over() -> None:
    spare = BufferPool(4)
    buffer, data = handed_out(b"first message")
    del data
    assert spare.exchange(buffer) is buffer
    assert buffer.tell() == 0
    assert len(spare._kept) == 0


def test_what_somebody_holds_is_not() -> None:
    spare = BufferPool(2)
    first, held = handed_out(b"first message")
    view = memoryview(held)[3:]
    del held
    fresh = spare.exchange(first)
    assert fresh is not first
    assert fresh.getvalue() == b""
    second, held_too = handed_out(b"second message")
    assert spare.exchange(second) not in (first, second)
    del held_too
    third, _held = handed_out(b"third message")
    assert spare.exchange(third) is second, "the first fell out: no more than two are kept"
    assert view.tobytes() == b"st message"
    del view


def test_a_holder_loses_nothing_whatever_the_count_says() -> None:
    buffer, held = handed_out(b"first message")
    buffer.seek(0)
    buffer.write(b"other")
    assert held == b"first message"


def test_another_thread_may_take_the_last() -> None:
    spare = BufferPool(2)

    class Emptied(deque[BytesIO]):
        def popleft(self) -> BytesIO:
            raise IndexError

    spare._kept = Emptied(maxlen=2)
    buffer, _ = handed_out(b"message")
    assert spare.exchange(buffer) is not buffer

"""Memory is reused only if its bytes are not referenced."""

from collections import deque
from io import BytesIO

from rossec.inprocess.publishing import BufferPool


def handed_out(content: bytes) -> tuple[BytesIO, bytes]:
    buffer = BytesIO()
    buffer.write(content)
    return buffer, buffer.getvalue()


def test_a_buffer_without_references_is_reused() -> None:
    pool = BufferPool(4)
    buffer, data = handed_out(b"first message")
    del data
    assert pool.exchange(buffer) is buffer
    assert buffer.tell() == 0
    assert len(pool._buffers) == 0


def test_a_referenced_buffer_is_not_reused() -> None:
    pool = BufferPool(2)
    first, held = handed_out(b"first message")
    view = memoryview(held)[3:]
    del held
    fresh = pool.exchange(first)
    assert fresh is not first
    assert fresh.getvalue() == b""
    second, held_too = handed_out(b"second message")
    assert pool.exchange(second) not in (first, second)
    del held_too
    third, _held = handed_out(b"third message")
    assert pool.exchange(third) is second, "the first fell out: no more than two are kept"
    assert view.tobytes() == b"st message"
    del view


def test_referenced_bytes_never_change() -> None:
    buffer, held = handed_out(b"first message")
    buffer.seek(0)
    buffer.write(b"other")
    assert held == b"first message"


def test_another_thread_may_take_the_last_buffer() -> None:
    pool = BufferPool(2)

    class Emptied(deque[BytesIO]):
        def popleft(self) -> BytesIO:
            raise IndexError

    pool._buffers = Emptied(maxlen=2)
    buffer, _ = handed_out(b"message")
    assert pool.exchange(buffer) is not buffer

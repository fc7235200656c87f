from hypothesis import given
from hypothesis import strategies as st

from rossec.channel.session import OPEN, SMALL, ReceiveBuffer


def put(buffer: ReceiveBuffer, data: bytes) -> int:
    room = buffer.free()
    count = min(len(room), len(data))
    room[:count] = data[:count]
    buffer.filled(count)
    return count


def test_it_moves_before_it_grows() -> None:
    buffer = ReceiveBuffer(8)
    assert put(buffer, b"abcdefgh") == 8
    buffer.consume(6)
    buffer.expect(8, 8)
    assert buffer.capacity == 8
    assert put(buffer, b"ijklmnop") == 6
    assert bytes(buffer.unread()) == b"ghijklmn"
    buffer.expect(9, 20)
    assert buffer.capacity == 20
    assert bytes(buffer.unread()) == b"ghijklmn"


def test_room_is_earned_by_bytes_and_not_by_what_is_announced() -> None:
    buffer = ReceiveBuffer(8)
    put(buffer, b"abcd")
    buffer.expect(1000, 1000)
    assert buffer.capacity == 32
    while len(buffer) < 32:
        put(buffer, b"a" * 32)
    buffer.expect(1000, 1000)
    assert buffer.capacity == 256


def test_a_full_buffer_doubles_and_a_cleared_one_has_nothing() -> None:
    buffer = ReceiveBuffer(8)
    put(buffer, b"abcdefgh")
    assert len(buffer.free()) == 8
    assert buffer.capacity == 16
    view = buffer.unread()
    buffer.clear()
    assert (len(buffer), buffer.capacity, bytes(view)) == (0, 0, b"abcdefgh")


def test_free_is_never_empty() -> None:
    buffer = ReceiveBuffer(4)
    put(buffer, b"abcd")
    assert len(buffer.free()) > 0
    buffer.consume(4)
    assert len(buffer.free()) == buffer.capacity


def test_an_authenticated_peer_gets_more_room() -> None:
    buffer = ReceiveBuffer()
    put(buffer, b"a stranger's")
    assert buffer.capacity == SMALL
    buffer.enlarge()
    buffer.consume(len(buffer))
    assert len(buffer.free()) == OPEN


@given(st.lists(st.tuples(st.binary(max_size=40), st.integers(0, 40), st.integers(0, 60))))
def test_it_is_a_queue(steps: list[tuple[bytes, int, int]]) -> None:
    buffer, model = ReceiveBuffer(16), b""
    for data, drop, reserve in steps:
        count = put(buffer, data)
        model += data[:count]
        buffer.consume(min(drop, len(model)))
        model = model[drop:]
        buffer.expect(reserve, reserve)
        assert bytes(buffer.unread()) == model
        assert len(buffer) == len(model)

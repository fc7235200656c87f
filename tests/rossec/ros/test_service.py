import struct

import pytest

from rossec.errors import ServiceFailed, WireError
from rossec.ros import tcpros as wire


def joined(pieces: list[bytes | bytearray | memoryview]) -> bytes:
    return b"".join(pieces)


def test_a_request_and_a_response_as_rospy_writes_them() -> None:
    assert joined(wire.framed([b"ab", memoryview(b"c")])) == b"\3\0\0\0abc"
    assert joined(wire.success([b"ab", b"c"])) == b"\1\3\0\0\0abc"
    message = "no power"
    expected = struct.pack(f"<BI{len(message)}s", 0, len(message), message.encode())
    assert joined(wire.failure(message)) == expected  # rospy's _write_service_error


@pytest.mark.parametrize("step", [1, 3, 1000])
def test_a_response_is_read_however_it_arrives(step: int) -> None:
    data, reader = joined(wire.success([b"answer"])), wire.response_reader()
    arrived = [reader.feed_one(data[at : at + step]) for at in range(0, len(data), step)]
    assert arrived[:-1] == [None] * (len(arrived) - 1)
    assert arrived[-1] is not None
    assert wire.open_response(arrived[-1]) == b"answer"


def test_a_failure_has_its_reason() -> None:
    for reason, said in (("no\npower", r"no\\u000apower"), ("", "without a reason")):
        content = wire.response_reader().feed_one(joined(wire.failure(reason)))
        assert content is not None
        with pytest.raises(ServiceFailed, match=said):
            wire.open_response(content)
    assert len(joined(wire.failure("é" * 5000))) <= 5 + 4096
    with pytest.raises(ServiceFailed):
        wire.open_response(b"\0\xff")


def test_an_invalid_ok_byte() -> None:
    with pytest.raises(WireError, match="neither a success nor a failure"):
        wire.open_response(b"\2abc")
    with pytest.raises(WireError):
        wire.open_response(b"")


def test_a_tail_and_a_request_that_is_too_long() -> None:
    with pytest.raises(WireError, match="before its answer"):
        wire.request_reader().feed_one(joined(wire.framed([b"abc"])) + b"x")
    with pytest.raises(WireError, match="at most 16777216"):
        wire.request_reader().feed_one(struct.pack("<I", wire.REQUEST_LIMIT + 1))

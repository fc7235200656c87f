"""Messages of HTTP end where their heads say, and what is too long is counted, not kept."""

import pytest

from rossec.errors import HttpRefused
from rossec.ros.http import DROP_LIMIT, HEADERS_LIMIT, HttpReader, Oversized

HEAD = b"POST / HTTP/1.1\r\nContent-Length: 5"


def in_body(reader: HttpReader) -> bool:
    return reader.in_body


def begun(limit: int = 10) -> HttpReader:
    reader = HttpReader(limit)
    reader.feed(HEAD + b"\r\n\r\n")
    assert reader.head() == HEAD
    return reader


def test_a_body_in_pieces_and_what_follows_it() -> None:
    reader = begun()
    reader.expect(HEAD, 5)
    assert in_body(reader)
    reader.feed(b"12")
    assert reader.body() is None
    reader.feed(b"345POST")
    assert reader.body() == b"12345"
    assert not in_body(reader)
    assert reader.pending
    assert reader.rest(0) == b"POST"


def test_a_body_that_is_too_long_is_not_expected() -> None:
    with pytest.raises(HttpRefused, match="longer than 4 bytes"):
        begun(4).expect(HEAD, 5)


def test_a_dropped_body_is_read_to_its_end_and_not_kept() -> None:
    reader = begun(4)
    reader.drop(HEAD, 100_000)
    for _ in range(99):
        reader.feed(b"x" * 1000)
        assert reader.body() is None
        assert not reader._rest
    assert in_body(reader)
    assert reader.pending
    reader.feed(b"x" * 1000 + b"POST")
    assert reader.body() == Oversized(100_000)
    assert not in_body(reader)
    assert reader.head() is None
    assert reader.rest(0) == b"POST"


def test_a_body_is_not_read_for_ever_to_be_refused() -> None:
    with pytest.raises(HttpRefused) as refused:
        begun(4).drop(HEAD, DROP_LIMIT + 1)
    assert refused.value.status == 413


@pytest.mark.parametrize(("data", "status"), [(b"\x16\x03", 400), (b"P" * (HEADERS_LIMIT + 1), 431)])
def test_a_head_is_one_and_short(data: bytes, status: int) -> None:
    reader = HttpReader(10)
    reader.feed(data)
    with pytest.raises(HttpRefused) as refused:
        reader.head()
    assert refused.value.status == status

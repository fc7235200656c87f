"""Deflated messages: what gets shorter, what is refused, and how much is inflated at most."""

import gc
import hashlib
import struct
import tracemalloc
import zlib
from concurrent.futures import ThreadPoolExecutor

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rossec.errors import WireError
from rossec.participant import delivery_options
from rossec.participant.delivery_options import (
    LARGE,
    OVERHEAD,
    Deflatable,
    SharedDeflation,
    claimed_size,
    deflated,
    inflated,
)

LIMIT = 1 << 20
TEXT = b"the same words again and again, " * 100


def raw(data: bytes) -> bytes:
    engine = zlib.compressobj(9, zlib.DEFLATED, -15)
    return engine.compress(data) + engine.flush()


def content(data: bytes, size: int | None = None) -> bytes:
    return b"\1" + struct.pack("<I", len(data) if size is None else size) + raw(data)


@given(st.lists(st.binary(max_size=300), max_size=5), st.booleans())
def test_every_message_comes_back(pieces: list[bytes], repeated: bool) -> None:
    pieces = pieces * 9 if repeated else pieces
    message = b"".join(pieces)
    packed = deflated([memoryview(piece) for piece in pieces])
    assert inflated(packed, LIMIT) == message
    assert claimed_size(packed, LIMIT) == len(message)
    assert len(packed) <= len(message) + OVERHEAD


def test_what_does_not_get_shorter_is_sent_as_it_is() -> None:
    noise = hashlib.sha512(b"noise").digest()
    assert deflated([TEXT[:63]]) == b"\0" + TEXT[:63]
    assert deflated([noise]) == b"\0" + noise
    assert deflated([]) == b"\0"
    assert deflated([TEXT, TEXT])[:5] == b"\1" + struct.pack("<I", 2 * len(TEXT))


def test_a_size_above_the_limit_is_refused_before_anything_is_inflated(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(zlib, "decompressobj", None)
    for packed in (content(bytes(LIMIT + 1)), b"\0" + bytes(LIMIT + 1)):
        with pytest.raises(WireError, match=f"at most {LIMIT} allowed"):
            inflated(packed, LIMIT)


@pytest.mark.parametrize(
    ("packed", "said"),
    [
        (b"", "neither"),
        (b"\2" + TEXT, "neither"),
        (b"\1", "neither"),
        (b"\1\0\0\0\0", "neither"),
        (b"\1\xff\0\0\0" + TEXT, "longer when deflated"),
        (content(b""), "longer when deflated"),
        (content(TEXT, len(TEXT) - 1), "has not the 3199 bytes"),
        (content(TEXT, len(TEXT) + 1), "has not the 3201 bytes"),
        (content(bytes(LIMIT), 2000), "has not the 2000 bytes"),
        (content(TEXT)[:-1], "has not the"),
        (content(TEXT) + b"\0", "has not the"),
        (content(TEXT) + content(TEXT)[5:], "has not the"),
        (b"\1" + struct.pack("<I", 400) + b"\xff" * 99, "cannot be inflated"),
        (b"\1" + struct.pack("<I", len(TEXT)) + zlib.compress(TEXT), "cannot be inflated"),
    ],
)
def test_what_is_not_what_it_says_is_refused(packed: bytes, said: str) -> None:
    with pytest.raises(WireError, match=said):
        inflated(packed, LIMIT)


def test_every_byte_of_a_deflated_message_counts() -> None:
    """No second form of a message: none is accepted that is cut, and none grows beyond its size."""
    packed = content(TEXT)
    for end in range(len(packed)):
        with pytest.raises(WireError):
            inflated(packed[:end], LIMIT)


def test_a_bomb_that_lies_about_its_size_takes_no_more_memory_than_it_says() -> None:
    bomb = content(bytes(64 << 20), 70_000)
    gc.collect()
    tracemalloc.start()
    with pytest.raises(WireError, match="has not the 70000 bytes"):
        inflated(bomb, LIMIT)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 1 << 20


def test_it_is_deflated_once_for_all_receivers(monkeypatch: pytest.MonkeyPatch) -> None:
    calls = []

    def count(pieces: list[bytes]) -> bytes:
        calls.append(pieces)
        return deflated(pieces)

    monkeypatch.setattr(delivery_options, "deflated", count)
    shared, source, other = SharedDeflation(), object(), object()
    first = shared.of([TEXT], source)
    assert shared.of([TEXT], source) is first
    with ThreadPoolExecutor(8) as pool:
        assert {*pool.map(lambda _: first.content(), range(32))} == {deflated([TEXT])}
    assert len(calls) == 1
    second = shared.of([TEXT], other)
    assert second is not first
    assert second.content() == first.content()
    assert len(calls) == 2


def test_a_message_that_nobody_waits_for_is_not_kept() -> None:
    """Unless it is small: then it is kept until the next one."""
    shared, large = SharedDeflation(), bytes(LARGE)
    for message, kept in ((TEXT, True), (large, False)):
        one = shared.of([message], message)
        assert isinstance(one, Deflatable)
        content = one.content()
        del one
        gc.collect()
        assert shared._last is not None
        assert (shared._last() is not None) is kept
        assert shared.of([message], message).content() == content

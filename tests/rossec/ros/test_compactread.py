"""Bytes to values: what is written is read, and nothing else is."""

import time
from collections.abc import Callable
from datetime import datetime
from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rossec.errors import CompactRefused
from rossec.ros.compact_values import ARRAY, MALFORMED, CompactReader, encoded
from rossec.ros.xmlrpc import dump_call, load_call, run_out
from tests.rossec.ros.test_compactwrite import ENCODINGS
from tests.rossec.ros.values import VALUES, shape

LIMIT = 1 << 20


def read(data: bytes, limit: int = LIMIT) -> object:
    """What is read at once; in steps the same is read, or refused."""
    reader, other = CompactReader(data, limit), CompactReader(data, limit)
    try:
        (value,) = reader.items(1)
    except (CompactRefused, *MALFORMED) as error:
        with pytest.raises(type(error)):
            run_out(other.steps(1))
        raise
    assert shape(run_out(other.steps(1))) == shape([value])
    assert other.at == reader.at
    if not reader.at_end:
        raise CompactRefused("not at its end")
    return value


@pytest.mark.parametrize("written", [written for _, written in ENCODINGS])
def test_each_form_is_read_and_written_again(written: str) -> None:
    assert encoded(read(bytes.fromhex(written))).hex() == written


@given(VALUES)
def test_what_is_written_is_read(value: object) -> None:
    assert shape(read(encoded(value))) == shape(value)


def at_once(data: bytes) -> object:
    return CompactReader(data, LIMIT).items(1)


REFUSED = {
    "a long zero": "1800",
    "a long 23": "1817",
    "255 in two bytes": "1900ff",
    "65535 in four": "1a0000ffff",
    "eight bytes": "1b0000000000000001",
    "2**31": "1a80000000",
    "-2**31 - 1": "3a80000000",
    "a long text": "780161",
    "a longer text": "79001861" + "61" * 23,
    "a long array": "9800",
    "a long map": "b800",
    "an indefinite text": "7f6161ff",
    "indefinite bytes": "5f4161ff",
    "an indefinite array": "9f01ff",
    "an indefinite map": "bf616101ff",
    "a reserved length": "1c",
    "a tag for a time": "c0" + "74" + b"2026-11-23T09:08:07Z".hex(),
    "a bignum": "c249010000000000000000",
    "a tagged regular expression": "d823" + "6161",
    "a shared value": "d81c00",
    "null": "f6",
    "undefined": "f7",
    "another simple value": "e0",
    "a simple value in two bytes": "f820",
    "a half": "f93c00",
    "a single": "fa3f800000",
    "a NaN with a payload": "fb7ff8000000000001",
    "a signalling NaN": "fb7ff0000000000001",
    "a negative NaN": "fbfff8000000000000",
    "not UTF-8": "61ff",
    "an overlong slash": "62c0af",
    "a surrogate": "63eda080",
    "half a letter": "61c3",
    "a null character": "6100",
    "a character without a form in XML": "63efbfbf",
    "members out of order": "a2616201616101",
    "a longer member first": "a262616101616201",
    "a member twice": "a2616101616102",
    "a number for a name": "a10101",
    "a time and more": "a200" + "71" + b"20261123T09:08:07".hex() + "616101",
    "bytes for a name": "a1416101",
    "a time that is none": "a100" + "71" + b"20261323T09:08:07".hex(),
    "a time with a sign": "a100" + "71" + b"2026+123T09:08:07".hex(),
    "a shorter time": "a100" + "70" + b"2026123T09:08:07".hex(),
    "nothing": "",
    "a text cut off": "6261",
    "a long text cut off": "781861",
    "a longer text cut off": "790100" + "61" * 255,
    "bytes cut off": "4201",
    "a double cut off": "fb3ff0",
    "an array cut off": "8201",
    "a map cut off": "a16161",
    "two values": "0101",
}


@pytest.mark.parametrize("written", REFUSED.values(), ids=REFUSED)
@pytest.mark.parametrize("around", ["", "81", "a16161"])
def test_other_forms_are_refused(written: str, around: str) -> None:
    with pytest.raises((CompactRefused, *MALFORMED)):
        read(bytes.fromhex(around + written))


def test_depth_is_bounded() -> None:
    assert read(b"\x81" * 40 + b"\x01")
    for nested in (b"\x81" * 41 + b"\x01", b"\xa1\x61\x61" * 41 + b"\x01", b"\x81" * 100_000):
        with pytest.raises(CompactRefused, match="deeper than 40"):
            read(nested)


def test_the_number_of_values_is_bounded_before_they_are_built() -> None:
    assert len(read(bytes.fromhex("99ffff") + b"\x80" * 65535)) == 65535  # type: ignore[arg-type]
    for many in (
        bytes.fromhex("9a00010000") + b"\x80" * 65536,
        bytes.fromhex("9affffffff"),
        b"\x82" + 2 * (bytes.fromhex("998000") + b"\x80" * 32768),
    ):
        with pytest.raises(CompactRefused, match="too many values"):
            read(many)
    with pytest.raises(CompactRefused, match="too many values"):
        read(encoded({f"{n}": n for n in range(10)}), 16 * 20)


@pytest.mark.parametrize("written", ["20261123T09:08:60", "20261123T9:008:07", "٢261123T09:08:07"])
def test_a_time_has_digits_in_their_places(written: str) -> None:
    assert len(written.encode()) == 17
    with pytest.raises((CompactRefused, *MALFORMED)):
        read(bytes.fromhex("a10071") + written.encode())


def test_times_delay_the_reader_no_longer_than_in_xml() -> None:
    """A master reads each call in one go, and everybody waits."""
    when = datetime.fromisoformat("2026-11-23T09:08:07")
    unit = b"\x99" + (50_000).to_bytes(2) + encoded(when) * 50_000
    body = dump_call("setParam", [[when] * 14_000])
    assert len(body) < LIMIT
    assert min(seconds(at_once, unit) for _ in range(3)) < min(seconds(load_call, body) for _ in range(3))


def seconds(load: Callable[[bytes], object], data: bytes) -> float:
    begin = time.process_time()
    load(data)
    return time.process_time() - begin


def test_a_head_and_a_byte() -> None:
    reader = CompactReader(b"\x82\xf6\x01", LIMIT)
    assert reader.head(ARRAY) == 2
    assert reader.skip(b"\xf6")
    assert not reader.skip(b"\xf6")
    assert reader.items(1) == [1]
    assert reader.at_end


@given(st.binary(max_size=60))
def test_whatever_is_read_would_be_written_so(data: bytes) -> None:
    try:
        value = read(data)
    except (CompactRefused, *MALFORMED):
        return
    assert encoded(value) == data


def test_a_large_value_is_read_in_steps_of_a_thousand_values() -> None:
    data = encoded([{f"{number}": [number, "x"]} for number in range(20_000)])
    reader = CompactReader(data, 4 << 20)
    places = [reader.at for _ in reader.steps(1)]
    assert len(places) == 80_001 // 1024
    assert max(late - early for early, late in pairwise([0, *places, len(data)])) <= 1024 * 6

"""Units of calls and answers."""

from contextlib import suppress
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rossec.errors import CompactRefused, XmlRpcRefused
from rossec.ros import calls
from rossec.ros.calls import (
    METHODS,
    TURNS,
    UNPARSED,
    dump_compact_answer,
    dump_compact_call,
    load_compact_answer,
    load_compact_call,
)
from rossec.ros.compact_values import encoded
from rossec.ros.xmlrpc import BODY_LIMIT, Encoded, Fault
from tests.rossec.ros.values import VALUES, shape

GET = dump_compact_call(3, "getParam", ("/a", "/rate"))


def test_the_bytes_of_a_call_and_its_answer() -> None:
    assert GET.hex(" ", 1) == "85 18 52 03 00 62 2f 61 65 2f 72 61 74 65"
    assert load_compact_call(GET, 3) == ("getParam", ("/a", "/rate"))
    unit = dump_compact_answer(3, [1, "ok", 10])
    assert unit.hex(" ", 1) == "84 03 01 62 6f 6b 0a"
    assert load_compact_answer(unit, 3, "getParam") == [1, "ok", 10]


@given(
    st.integers(0, TURNS - 1),
    st.sampled_from(METHODS) | st.just("rossec.later"),
    st.lists(VALUES, max_size=30),
)
def test_what_is_called_arrives(turn: int, method: str, params: list[object]) -> None:
    call = load_compact_call(dump_compact_call(turn, method, params), turn)
    assert (call.method, shape(list(call.params))) == (method, shape(params))


@given(
    VALUES
    | st.tuples(st.integers(-5, 5), st.text("ab", max_size=9), VALUES).map(list)
    | st.lists(VALUES, min_size=3, max_size=3)
)
def test_what_is_answered_arrives(value: object) -> None:
    assert shape(load_compact_answer(dump_compact_answer(7, value), 7, "getParam")) == shape(value)


def test_a_fault_arrives_as_a_fault() -> None:
    fault: Any = load_compact_answer(dump_compact_answer(0, Fault(1, "no\nsuch")), 0, "getParam")
    assert isinstance(fault, Fault)
    assert (fault.faultCode, fault.faultString) == (1, "no\\u000asuch")


def test_a_body_of_a_program_arrives_as_it_was_and_only_where_it_may() -> None:
    unit = dump_compact_answer(0, Encoded(b"<not quite XML"))
    assert load_compact_answer(unit, 0, UNPARSED) == Encoded(b"<not quite XML")
    with pytest.raises(CompactRefused, match="a body of XML-RPC in the answer to getParam"):
        load_compact_answer(unit, 0, "getParam")


NO_CALLS = {
    "empty": b"",
    "a request of HTTP": b"POST / HTTP/1.1\r\n",
    "another mark": b"\x84\x18\x53\x03\x00\x60",
    "a mark in three bytes": b"\x84\x19\x00\x52\x03\x00\x60",
    "no method": b"\x82\x18\x52\x03",
    "a map": b"\xa1\x18\x52\x03",
    "an array without an end": b"\x9f\x18\x52\x03\x00\xff",
    "a long array": b"\x98\x03\x18\x52\x03\x00",
    "another number": b"\x83\x18\x52\x04\x00",
    "a number that is a text": b"\x83\x18\x52\x61\x33\x00",
    "an unknown method": b"\x83\x18\x52\x03\x18\x3d",
    "a negative method": b"\x83\x18\x52\x03\x20",
    "a method that is true": b"\x83\x18\x52\x03\xf5",
    "no name": b"\x83\x18\x52\x03\x60",
    "a name that has a number": b"\x83\x18\x52\x03" + encoded("getParam"),
    "a name that is too long": b"\x83\x18\x52\x03" + encoded("x" * 257),
    "two calls": GET + GET,
    "a byte more": GET + b"\x00",
    "a byte less": GET[:-1],
    "null": b"\x84\x18\x52\x03\x00\xf6",
    "not UTF-8": b"\x84\x18\x52\x03\x00\x61\xff",
    "too long": encoded("x" * BODY_LIMIT),
}


@pytest.mark.parametrize("data", NO_CALLS.values(), ids=NO_CALLS)
def test_other_units_are_no_calls(data: bytes) -> None:
    with pytest.raises(CompactRefused):
        load_compact_call(data, 3)


NO_ANSWERS = {
    "empty": b"",
    "a call": GET,
    "a number alone": b"\x81\x03",
    "five items": b"\x85\x03\x01\x60\x00\x00",
    "another number": b"\x84\x02\x01\x60\x00",
    "a code that is true": b"\x84\x03\xf5\x60\x00",
    "a status that is none": b"\x84\x03\x01\x00\x00",
    "a fault without a text": b"\x83\x03\x01\x00",
    "a fault with true": b"\x83\x03\xf5\x60",
    "a body that is text": b"\x83\x03\xf6\x60",
    "code, status and value inside": b"\x82\x03\x83\x01\x60\x00",
    "two answers": b"\x82\x03\x00\x82\x04\x00",
    "a byte less": b"\x84\x03\x01\x61",
    "too long": encoded("x" * BODY_LIMIT),
}


@pytest.mark.parametrize("data", NO_ANSWERS.values(), ids=NO_ANSWERS)
def test_other_units_are_no_answers(data: bytes) -> None:
    with pytest.raises(CompactRefused):
        load_compact_answer(data, 3, UNPARSED)


def test_what_cannot_be_carried_is_refused_before_it_is_sent() -> None:
    for value in (None, 2**31, "\x00", {1: 1}):
        with pytest.raises(XmlRpcRefused, match="cannot carry"):
            dump_compact_call(0, "setParam", ("/a", value))
        with pytest.raises(XmlRpcRefused, match="cannot carry"):
            dump_compact_answer(0, [1, "", value])
    with pytest.raises(XmlRpcRefused, match="cannot carry"):
        dump_compact_call(0, "ro\x00s", ())


@pytest.mark.parametrize("value", ["x" * 1000, [[]] * 63])
def test_an_answer_that_no_peer_accepts_is_a_fault(value: object) -> None:
    assert dump_compact_answer(0, [1, "", "x" * 900], limit=1000)
    with pytest.raises(Fault, match=r"the answer has \d+ bytes, at most 1000 are sent"):
        dump_compact_answer(0, [1, "", value], limit=1000)


def test_depth_counts_from_the_whole_answer_as_in_xml_rpc() -> None:
    value: object = 1
    for _ in range(39):
        value = [value]
    unit = dump_compact_answer(0, [1, "", value])
    assert load_compact_answer(unit, 0, "getParam") == [1, "", value]
    with pytest.raises(XmlRpcRefused, match="deeper"):
        dump_compact_answer(0, [1, "", [value]])
    with pytest.raises(CompactRefused, match="deeper"):
        load_compact_answer(b"\x84\x00\x01\x60" + b"\x81" * 40 + b"\x01", 0, "getParam")


@given(st.binary(max_size=80))
def test_any_bytes_are_read_or_refused(data: bytes) -> None:
    with suppress(CompactRefused):
        load_compact_call(data, 0)
    with suppress(CompactRefused):
        load_compact_answer(data, 0, "getParam")


def test_every_byte_that_differs_makes_another_call_or_none() -> None:
    """One value, one encoding: no two units are the same call."""
    seen = {bytes(GET): load_compact_call(GET, 3)}
    for place in range(len(GET)):
        for byte in range(256):
            data = GET[:place] + bytes((byte,)) + GET[place + 1 :]
            try:
                call = load_compact_call(data, 3)
            except CompactRefused:
                continue
            assert calls.dump_compact_call(3, call.method, call.params) == data
            seen[data] = call
    assert len({repr(call) for call in seen.values()}) == len(seen)

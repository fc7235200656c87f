"""What is written is what the standard library writes."""

import datetime
import xmlrpc.client

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rossec.ros import xmlrpc as xmlwrite
from rossec.ros.xmlrpc import EncodedList
from tests.rossec.ros.test_xmlscan import values


def library(value: object) -> str:
    return xmlrpc.client.dumps((value,), methodresponse=True)  # type: ignore[arg-type]


@given(values)
def test_it_agrees_with_the_library(value: object) -> None:
    assert xmlwrite.response_text(value) == library(value)


@given(st.lists(values, max_size=4).map(tuple))
def test_calls(params: tuple[object, ...]) -> None:
    assert xmlwrite.call_text("setParam", params) == xmlrpc.client.dumps(params, "setParam")  # type: ignore[arg-type]


@pytest.mark.parametrize("value", [(1, "a&<>b", [])], ids=["triple"])
def test_answers(value: object) -> None:
    assert xmlwrite.response_text(value) == library(value)


def test_times_are_left_to_the_library() -> None:
    when = datetime.datetime(2026, 1, 2, 3, 4, 5)  # noqa: DTZ001 - XML-RPC knows no zone
    assert xmlwrite.response_text([when]) == library([when])


def test_a_written_list_is_the_list() -> None:
    plain = [1, "state", [["/a", ["/n"]], []]]
    written = EncodedList([["/a", ["/n"]], []])
    assert written == plain[2]
    assert xmlwrite.response_text([1, "state", written]) == library(plain)


@pytest.mark.parametrize("value", [None, 2**31, -(2**31) - 1, object()])
def test_what_cannot_be_carried(value: object) -> None:
    with pytest.raises((TypeError, OverflowError)):
        xmlwrite.response_text([value])

"""What is written is what the standard library writes."""

import datetime
import xmlrpc.client

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rossec.errors import XmlRpcRefused
from rossec.ros import xmlrpc as xmlwrite
from rossec.ros.xmlrpc import EncodedList
from tests.rossec.ros.test_xmlscan import values


def library(value: object) -> str:
    return xmlrpc.client.dumps((value,), methodresponse=True)  # type: ignore[arg-type]


@given(values)
def test_it_agrees_with_the_library(value: object) -> None:
    assert xmlwrite.dump_response(value).decode() == library(value)


@given(st.lists(values, max_size=4).map(tuple))
def test_calls(params: tuple[object, ...]) -> None:
    assert xmlwrite.dump_call("setParam", params).decode() == xmlrpc.client.dumps(params, "setParam")  # type: ignore[arg-type]


@pytest.mark.parametrize("value", [(1, "a&<>b", [])], ids=["triple"])
def test_answers(value: object) -> None:
    assert xmlwrite.dump_response(value).decode() == library(value)


def test_times_are_left_to_the_library() -> None:
    when = datetime.datetime(2026, 1, 2, 3, 4, 5)  # noqa: DTZ001 - XML-RPC knows no zone
    assert xmlwrite.dump_response([when]).decode() == library([when])


def test_a_written_list_is_the_list() -> None:
    plain = [1, "state", [["/a", ["/n"]], []]]
    written = EncodedList([["/a", ["/n"]], []])
    assert written == plain[2]
    assert xmlwrite.dump_response([1, "state", written]).decode() == library(plain)


@pytest.mark.parametrize("value", [None, 2**31, -(2**31) - 1, object()])
def test_what_cannot_be_carried(value: object) -> None:
    with pytest.raises(XmlRpcRefused):
        xmlwrite.dump_response([value])

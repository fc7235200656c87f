"""The short way says what the XML parser says, or nothing."""

import datetime

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rossec.errors import XmlRpcRefused
from rossec.ros import xmlrpc
from rossec.ros.xmlrpc import scan

values = st.recursive(
    st.booleans()
    | st.integers(-(2**31), 2**31 - 1)
    | st.floats(allow_nan=False)
    | st.text("ab \n\r\t]>&\u00e9", max_size=5)
    | st.binary(),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text("a/"), inner, max_size=3),
    max_leaves=8,
)
PIECES = [
    f"<{end}{tag}>"
    for tag in (
        "methodCall",
        "methodResponse",
        "methodName",
        "params",
        "param",
        "value",
        "array",
        "data",
        "struct",
        "member",
        "name",
        "int",
        "i4",
        "string",
        "boolean",
        "double",
        "base64",
        "nil",
    )
    for end in ("", "/")
]
TEXTS = ["", " ", "\r\n", "1", "-7", "x", "1_0", "AA==", "]]>", "&lt;", "<!-- -->", "<int/>", "\x01"]
HEAD = "<methodCall><methodName>m</methodName><params>"
TAIL = "</params></methodCall>"


def agree(data: bytes) -> bool:
    """Whether the short way took it; if so, the parser must say the same."""
    found = scan(data)
    if found is not None:
        assert xmlrpc.run_out(xmlrpc._parse(data)) == found
    return found is not None


@given(st.lists(values, max_size=4).map(tuple))
def test_what_stock_sends_is_read_alike(params: tuple[object, ...]) -> None:
    agree(xmlrpc.dump_call("m", params))
    agree(xmlrpc.dump_response(list(params)))


@given(st.lists(st.sampled_from(PIECES + TEXTS)).map("".join))
def test_nothing_is_read_that_the_parser_refuses(middle: str) -> None:
    for text in (middle, HEAD + middle + TAIL, f"{HEAD}<param><value>{middle}</value></param>{TAIL}"):
        agree(text.encode())


@given(st.data())
def test_damage_is_noticed(data: st.DataObject) -> None:
    whole = xmlrpc.dump_call("m", ("/a", [1, {"b": True}], 2.5, b"x"))
    at = data.draw(st.integers(0, len(whole) - 1))
    agree(whole[:at] + data.draw(st.binary(max_size=2)) + whole[at + 1 :])


@pytest.mark.parametrize("value", ["/a/b", "", 5, -5, True, 2.5])
def test_plain_calls_take_the_fast_path(value: object) -> None:
    assert agree(xmlrpc.dump_call("m", (value, value)))


def test_roscpp_takes_the_fast_path() -> None:
    data = (
        b'<?xml version="1.0"?>\r\n<methodCall><methodName>m</methodName>\r\n<params><param>'
        b"<value>/a</value></param><param><value><i4>1</i4></value></param></params></methodCall>\r\n"
    )
    assert agree(data)
    assert agree(data.replace(b"\r\n", b""))


@pytest.mark.parametrize(
    "data",
    [
        xmlrpc.dump_call("m", ("caf\u00e9",)),
        xmlrpc.dump_call("m", ("a&b",)),
        xmlrpc.dump_call("m", ("a\rb",)),
        xmlrpc.dump_call("m", (datetime.datetime(2026, 1, 2),)),  # noqa: DTZ001 - as XML-RPC
        xmlrpc.dump_call("m", ([1],)),
        xmlrpc.dump_call("m", (b"x",)),
        xmlrpc.dump_call("m", (1,)).replace(b"<int>1<", b"<int>1_0<"),
        xmlrpc.dump_call("m", (True,)).replace(b">1<", b">2<"),
        xmlrpc.dump_response([1, "fine", 0]),
        xmlrpc.dump_response(xmlrpc.Fault(1, "x")),
        b"",
        b"<methodCall>",
        b"<methodCall><params></params></methodCall>",
    ],
)
def test_other_bodies_are_left_to_the_parser(data: bytes) -> None:
    assert not agree(data)


def test_depth() -> None:
    def nested(depth: int) -> bytes:
        return xmlrpc.dump_call("m", (eval("[" * depth + "]" * depth),))

    xmlrpc.load_call(nested(xmlrpc.DEPTH_LIMIT))
    with pytest.raises(XmlRpcRefused, match="deeper"):
        xmlrpc.load_call(nested(xmlrpc.DEPTH_LIMIT + 2))

"""XML-RPC bodies: round trips, bombs, the ROS triple."""

import datetime
from xmlrpc.server import SimpleXMLRPCDispatcher

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rossec.errors import AnswerMalformed, AnswerRefused, XmlRpcRefused
from rossec.ros import xmlrpc

VALUES = [
    True,
    -7,
    2.5,
    "caf\u00e9 <&>",
    b"\x00\xff",
    datetime.datetime(2026, 1, 2, 3, 4, 5),  # noqa: DTZ001 - XML-RPC has no zones
    [1, [2, "x"]],
    {"a": {"b": [False]}},
]
values = st.recursive(
    st.booleans() | st.integers(-(2**31), 2**31 - 1) | st.text("ab<&\u00e9", max_size=5) | st.binary(),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text("abc"), inner, max_size=3),
)


@pytest.mark.parametrize("value", VALUES)
def test_values_survive_both_directions(value: object) -> None:
    assert xmlrpc.load_call(xmlrpc.dump_call("m", [value])) == ("m", (value,))
    assert xmlrpc.load_response(xmlrpc.dump_response(value)) == value


@given(values)
def test_any_value_survives(value: object) -> None:
    assert xmlrpc.load_response(xmlrpc.dump_response(value)) == value


@given(st.binary(max_size=80) | st.text("<>/?!methodCallvalueparamsint0 ", max_size=80).map(str.encode))
def test_garbage_is_refused(data: bytes) -> None:
    with pytest.raises(XmlRpcRefused):
        xmlrpc.load_call(data)


def test_faults_are_raised() -> None:
    with pytest.raises(xmlrpc.Fault, match="no such method"):
        xmlrpc.load_response(xmlrpc.dump_response(xmlrpc.Fault(1, "no such method")))


def nested(depth: int) -> bytes:
    inner = b"<value><array><data>" * depth + b"</data></array></value>" * depth
    return b"<methodCall><methodName>m</methodName><params><param>%s</param></params></methodCall>" % inner


def test_depth_is_bounded() -> None:
    xmlrpc.load_call(nested(xmlrpc.DEPTH_LIMIT))
    with pytest.raises(XmlRpcRefused, match="deeper"):
        xmlrpc.load_call(nested(xmlrpc.DEPTH_LIMIT + 2))


BOMB = b"""<?xml version="1.0"?><!DOCTYPE m [<!ENTITY a "aaaaaaaaaa"><!ENTITY b "&a;&a;&a;">]>
<methodCall><methodName>&b;</methodName><params/></methodCall>"""


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (BOMB, "document type"),
        (b"<!DOCTYPE m SYSTEM 'file:///etc/passwd'><methodCall/>", "document type"),
        (nested(1).decode().encode("utf-16"), "malformed"),
        (nested(1)[:-5], "malformed"),
        (nested(1) + b"<x/>", "malformed"),
        (b"", "malformed"),
        (b"<methodCall><params/></methodCall>", "not an XML-RPC call"),
        (b"<methodCall><methodName></methodName><params/></methodCall>", "not an XML-RPC call"),
        (xmlrpc.dump_response(1), "not an XML-RPC call"),
        (xmlrpc.dump_response(xmlrpc.Fault(1, "x")), "not an XML-RPC call"),
        (xmlrpc.dump_call("m" * 300, []), "too long"),
        (nested(1).replace(b"<array><data></data></array>", b"<int>x</int>"), "malformed"),
        (nested(1).replace(b"<array><data></data></array>", b"<bigdecimal>x</bigdecimal>"), "malformed"),
    ],
)
def test_refuses(data: bytes, message: str) -> None:
    with pytest.raises(XmlRpcRefused, match=message):
        xmlrpc.load_call(data)


def test_size_is_checked_before_the_parse() -> None:
    with pytest.raises(XmlRpcRefused, match="at most 10"):
        xmlrpc.load_call(b"not even xml", limit=10)


def test_a_call_is_not_a_response() -> None:
    with pytest.raises(XmlRpcRefused, match="not an XML-RPC response"):
        xmlrpc.load_response(nested(1))


@pytest.mark.parametrize("value", [None, 2**40, object()])
def test_what_cannot_be_carried_is_refused(value: object) -> None:
    with pytest.raises(XmlRpcRefused, match="cannot carry"):
        xmlrpc.dump_response(value)


def test_the_ros_triple() -> None:
    assert xmlrpc.value_of([1, "", [3]]) == [3]
    with pytest.raises(AnswerRefused, match="unknown node") as refused:
        xmlrpc.value_of([-1, "unknown node", 0])
    assert refused.value.code == -1
    with pytest.raises(AnswerRefused, match="without a reason"):
        xmlrpc.value_of([0, "", 0])


def test_an_unknown_method_is_told_from_other_failures() -> None:
    stock = SimpleXMLRPCDispatcher()._marshaled_dispatch(xmlrpc.dump_call("dance", []))
    with pytest.raises(xmlrpc.Fault) as unknown:
        xmlrpc.load_response(stock)  # type: ignore[arg-type]  # these are bytes
    assert xmlrpc.is_unknown_method(unknown.value)
    for other in (
        xmlrpc.Fault(1, "rossec: internal error"),
        xmlrpc.Fault(1, 'rossec: method "dance" is not supported today'),
        xmlrpc.Fault(1, "the type is not supported"),
        AnswerRefused('method "dance" is not supported'),
    ):
        assert not xmlrpc.is_unknown_method(other)


def test_a_peers_status_is_one_printable_line() -> None:
    with pytest.raises(AnswerRefused) as refused:
        xmlrpc.value_of([-1, "no\nrossec: forged\x1b[0m", 0])
    assert str(refused.value) == "no\\u000arossec: forged\\u001b[0m"
    with pytest.raises(xmlrpc.Fault) as fault:
        xmlrpc.load_response(xmlrpc.dump_response(xmlrpc.Fault(7, "no\nrossec: forged")))
    assert (fault.value.faultCode, fault.value.faultString) == (7, "no\\u000arossec: forged")
    odd = xmlrpc.dump_response(xmlrpc.Fault(7, "no")).replace(b"<int>7</int>", b"<string>a\n</string>")
    with pytest.raises(xmlrpc.Fault) as fault:
        xmlrpc.load_response(odd)
    assert fault.value.faultCode == 0


@pytest.mark.parametrize("answer", [None, 1, [1, ""], [1, "", 0, 0], ["1", "", 0], [True, "", 0], [1, 2, 3]])
def test_anything_else_is_malformed(answer: object) -> None:
    with pytest.raises(AnswerMalformed):
        xmlrpc.value_of(answer)


@pytest.mark.parametrize("value", ["x" * 300_000, list(range(30_000)), {"a": ["&<>", b"x"] * 9999}])
def test_in_steps_the_same_is_read(value: object) -> None:
    call, response = xmlrpc.dump_call("setParam", ("/n", value)), xmlrpc.dump_response(value)
    assert xmlrpc.run_out(xmlrpc.call_steps(call)) == xmlrpc.load_call(call)
    assert xmlrpc.run_out(xmlrpc.response_steps(response)) == value
    assert sum(1 for _ in xmlrpc.call_steps(call)) == (len(call) - 1) // xmlrpc.STEP


@pytest.mark.parametrize("cut", [3, 20_000, 100_000])
def test_in_steps_the_same_is_refused(cut: int) -> None:
    call = xmlrpc.dump_call("setParam", ("/n", list(range(30_000))))[:-cut]
    with pytest.raises(XmlRpcRefused):
        xmlrpc.run_out(xmlrpc.call_steps(call))


@pytest.mark.parametrize("markup", ["<!--%s-->", "<value a='%s'/>", "<?%s?>", "<%s/>"])
def test_markup_that_would_be_read_again_with_each_step_is_refused(markup: str) -> None:
    """expat reads an incomplete tag from its beginning again: 4 MiB would be 512 MiB."""
    call = b"<methodCall>" + (markup % ("x" * (1 << 20))).encode() + b"</methodCall>"
    steps = xmlrpc.call_steps(call)
    with pytest.raises(XmlRpcRefused, match="a tag or comment of more than 65536 bytes"):
        xmlrpc.run_out(steps)


def test_a_fault_is_raised_in_steps_too() -> None:
    with pytest.raises(xmlrpc.Fault, match="why"):
        xmlrpc.run_out(xmlrpc.response_steps(xmlrpc.dump_response(xmlrpc.Fault(1, "why" * 9999))))

"""The calling side: it offers once, keeps to what the peer chose, takes one answer to a call."""

import pytest

from rossec.errors import CompactRefused, HttpRefused, XmlRpcRefused
from rossec.ros import calls, xmlrpc
from rossec.ros.calls import CallClient, body_of, value_in
from rossec.ros.xmlrpc import Encoded, Fault

SWITCH = b"HTTP/1.1 101 Switching Protocols\r\nConnection: Upgrade\r\nUpgrade: rossec-cbor/1\r\n\r\n"


def response(value: object) -> bytes:
    """As a peer of before answers."""
    body = xmlrpc.dump_response(value)
    return b"HTTP/1.1 200 OK\r\nContent-length: %d\r\n\r\n%s" % (len(body), body)


def switched() -> CallClient:
    """A client after its first answer."""
    client = CallClient("x")
    client.request("getPid", ("/a",))
    assert client.take(SWITCH + calls.dump_compact_answer(0, [1, "", 7])) == [1, "", 7]
    assert client.is_compact
    assert not client.closing
    return client


def test_the_offer_is_made_once_and_a_peer_of_before_answers_as_ever() -> None:
    client = CallClient("x")
    request = client.request("getPid", ("/a",))
    assert request.startswith(b"POST / HTTP/1.1\r\nHost: x\r\nConnection: Upgrade\r\nUpgrade: ")
    assert xmlrpc.load_call(request.partition(b"\r\n\r\n")[2]) == ("getPid", ("/a",))
    assert value_in(client.take(response([1, "", 7]))) == [1, "", 7]
    assert not client.is_compact
    assert b"Upgrade" not in client.request("getPid", ("/a",))


def test_an_answer_in_pieces() -> None:
    client, data = CallClient("x"), response([1, "", 7])
    client.request("getPid", ("/a",))
    assert all(client.take(data[at : at + 1]) is None for at in range(len(data) - 1))
    assert value_in(client.take(data[-1:])) == [1, "", 7]


def test_a_switch_that_nobody_offered_is_refused() -> None:
    for answer in (SWITCH, SWITCH.replace(b"/1\r\n\r\n", b"/2\r\n\r\n")):
        client = CallClient("x", compact=answer != SWITCH)
        client.request("getPid", ("/a",))
        with pytest.raises(HttpRefused, match="not offered"):
            client.take(answer + calls.dump_compact_answer(0, 1))
        assert client.closing


def test_a_switch_after_the_first_answer_is_refused() -> None:
    client = CallClient("x")
    client.request("getPid", ())
    client.take(response(1))
    client.request("getPid", ())
    with pytest.raises(HttpRefused, match="not offered"):
        client.take(SWITCH + calls.dump_compact_answer(0, 1))


def test_a_switch_brings_its_answer_with_it() -> None:
    client = CallClient("x")
    client.request("getPid", ())
    with pytest.raises(CompactRefused):
        client.take(SWITCH)


@pytest.mark.parametrize(
    "unit",
    [
        calls.dump_compact_answer(0, [1, "", 7]),
        calls.dump_compact_answer(2, [1, "", 7]),
        calls.dump_compact_answer(1, [1, "", 7]) * 2,
        response([1, "", 7]),
        b"",
    ],
    ids=["an old answer", "a later answer", "two", "HTTP", "nothing"],
)
def test_another_answer_is_refused_and_nothing_follows(unit: bytes) -> None:
    client = switched()
    client.request("getPid", ("/a",))
    with pytest.raises(CompactRefused):
        client.take(unit)
    assert client.closing


def test_an_answer_to_no_call_is_refused() -> None:
    with pytest.raises(CompactRefused, match="no call"):
        switched().take(calls.dump_compact_answer(1, [1, "", 7]))


def test_a_call_that_cannot_be_made_changes_nothing() -> None:
    for client in (CallClient("x"), switched()):
        with pytest.raises(XmlRpcRefused):
            client.request("setParam", ("/a", None))
        assert not client.closing
        assert client.request("setParam", ("/a", 1))


def test_values_faults_and_bodies() -> None:
    assert value_in(5) == 5
    assert value_in(Encoded(xmlrpc.dump_response(5))) == 5
    with pytest.raises(XmlRpcRefused):
        value_in(Encoded(b"<"))
    with pytest.raises(Fault, match="no"):
        value_in(Fault(1, "no"))
    assert body_of(5) == xmlrpc.dump_response(5)
    assert body_of(Encoded(b"<")) == b"<"
    with pytest.raises(Fault, match="no"):
        xmlrpc.load_response(body_of(Fault(1, "no")))

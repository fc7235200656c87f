"""The answering side: HTTP until the offer is taken, then units, one at a time."""

import pytest

from rossec.errors import CompactRefused, HttpRefused, XmlRpcRefused
from rossec.ros import calls, xmlrpc
from rossec.ros.calls import CallClient, CallServer, value_in
from rossec.ros.http import Oversized
from rossec.ros.xmlrpc import Encoded, Fault


def served(server: CallServer, data: bytes) -> object:
    """What the server is asked with `data`; it answers with the parameters."""
    request = server.take(data)
    assert request is not None
    call = server.load(request)
    return [1, call.method, list(call.params)]


def first(compact: bool = True) -> tuple[CallClient, CallServer]:
    """Both sides after one call."""
    client, server = CallClient("x"), CallServer(compact=compact)
    answer = client.take(server.respond(served(server, client.request("one", (1,)))))
    assert value_in(answer) == [1, "one", [1]]
    return client, server


def test_the_first_answer_is_the_first_unit() -> None:
    client, server = CallClient("x"), CallServer()
    value = served(server, client.request("one", (1,)))
    answer = server.respond(value)
    head, _, unit = answer.partition(b"\r\n\r\n")
    assert head.split(b"\r\n") == [
        b"HTTP/1.1 101 Switching Protocols",
        b"Connection: Upgrade",
        b"Upgrade: rossec-cbor/1",
    ]
    assert unit == calls.dump_compact_answer(0, [1, "one", [1]])
    assert server.is_compact
    assert value_in(client.take(answer)) == [1, "one", [1]]


def test_calls_are_numbered_and_numbers_begin_again() -> None:
    client, server = first()
    for n in range(60):
        request = client.request("getParam", (n,))
        assert request[3] == (n + 1) % 24
        answer = server.respond(served(server, request))
        assert answer[1] == (n + 1) % 24
        assert client.take(answer) == [1, "getParam", [n]]


def test_without_an_offer_or_without_leave_nothing_changes() -> None:
    _, server = first(compact=False)
    assert not server.is_compact
    request = CallClient("x", compact=False).request("two", ())
    assert b"Upgrade" not in request
    server = CallServer()
    assert b" 200 OK" in server.respond(served(server, request))
    assert not server.is_compact


@pytest.mark.parametrize(
    "offer",
    [
        b"Upgrade: rossec-cbor/1\r\n",
        b"Connection: Upgrade\r\nUpgrade: rossec-cbor/2\r\n",
        b"Connection: Upgrade\r\nUpgrade: websocket\r\n",
        b"Connection: Upgrade, close\r\nUpgrade: rossec-cbor/1\r\n",
        b"Connection: keep-alive\r\nUpgrade: rossec-cbor/1\r\n",
    ],
)
def test_half_an_offer_is_none(offer: bytes) -> None:
    body = xmlrpc.dump_call("one", (1,))
    for version in (b"1.1", b"1.0"):
        server = CallServer()
        head = b"POST / HTTP/%s\r\nHost: x\r\n%sContent-Length: %d\r\n\r\n"
        assert served(server, head % (version, offer, len(body)) + body)
        assert server.respond(1).startswith(b"HTTP/1.1 200")
        assert not server.is_compact


def test_an_old_version_of_http_offers_nothing() -> None:
    body, server = xmlrpc.dump_call("one", (1,)), CallServer()
    offer = b"Connection: Upgrade\r\nUpgrade: rossec-cbor/1\r\n"
    head = b"POST / HTTP/1.0\r\n%sContent-Length: %d\r\n\r\n" % (offer, len(body))
    assert served(server, head + body)
    assert server.respond(1).startswith(b"HTTP/1.1 200")


def test_an_offer_in_pieces_is_taken_too() -> None:
    server, request = CallServer(), CallClient("x").request("one", ())
    for at in range(len(request) - 1):
        assert server.take(request[at : at + 1]) is None
        assert server.pending
    found = server.take(request[-1:])
    assert found is not None
    server.load(found)
    assert server.respond(1).startswith(b"HTTP/1.1 101")


def test_an_offer_that_does_not_wait_for_its_answer_is_not_taken() -> None:
    """What follows it would be neither HTTP nor a unit."""
    client, server = CallClient("x"), CallServer()
    again = CallClient("x", compact=False).request("two", ())
    answer = server.respond(served(server, client.request("one", ()) + again))
    assert answer.startswith(b"HTTP/1.1 200")
    request = server.take()
    assert request is not None
    assert server.load(request).method == "two"


def test_a_call_before_the_answer_is_refused() -> None:
    client, server = first()
    request = client.request("two", ())
    served(server, request)
    assert server.answering
    with pytest.raises(CompactRefused, match="before the answer"):
        server.take(request)


def test_http_after_units_is_refused() -> None:
    _, server = first()
    request = server.take(CallClient("x").request("two", ()))
    assert request is not None
    with pytest.raises(CompactRefused):
        server.load(request)
    assert server.take() is None


@pytest.mark.parametrize("turn", [0, 2, 23])
def test_a_unit_out_of_its_turn_is_refused(turn: int) -> None:
    _, server = first()
    request = server.take(calls.dump_compact_call(turn, "getPid", ()))
    assert request is not None
    with pytest.raises(CompactRefused, match="out of its turn"):
        server.load(request)


def test_what_cannot_be_sent_leaves_the_call_to_be_answered() -> None:
    for server in (CallServer(limit=1000), first()[1]):
        client = CallClient("x") if not server.is_compact else None
        request = calls.dump_compact_call(1, "getPid", ()) if client is None else client.request("getPid", ())
        served(server, request)
        with pytest.raises(XmlRpcRefused):
            server.respond(None)
        with pytest.raises(Fault, match="ask for less"):
            server.respond("x" * (5 << 20))
        assert server.respond(Fault(1, "no"))


def test_both_forms_of_malformed() -> None:
    server = CallServer()
    request = server.take(b"POST / HTTP/1.1\r\nHost: x\r\nContent-Length: 1\r\n\r\n<")
    assert request is not None
    with pytest.raises(XmlRpcRefused):
        server.load(request)
    assert server.respond(Encoded(b"<x/>")).endswith(b"<x/>")
    with pytest.raises(HttpRefused):
        server.take(b"GET / HTTP/1.1\r\n\r\n")
    assert server.refuse(405).startswith(b"HTTP/1.1 405")
    assert server.closing


def stepped(server: CallServer, request: bytes | Oversized, bound: int | None = None) -> tuple[object, int]:
    steps, count = server.load_steps(request, bound), 0
    while True:
        try:
            next(steps)
        except StopIteration as stop:
            call = stop.value
            return [1, call.method, list(call.params)], count
        count += 1


@pytest.mark.parametrize("compact", [True, False])
def test_a_call_is_loaded_in_steps_as_at_once(compact: bool) -> None:
    client, server = first(compact=compact) if compact else (CallClient("x", compact=False), None)
    server = server or CallServer(compact=False)
    params = (["text"] * 20_000, {"a": 1})
    data = server.take(client.request("setParam", params))
    assert data is not None
    value, steps = stepped(server, data)
    assert value == [1, "setParam", list(params)]
    assert steps > 10


@pytest.mark.parametrize("compact", [True, False])
@pytest.mark.parametrize(
    ("method", "taken"),
    [
        ("setParam", False),
        ("getTopicTypes", False),  # numbered above 23, as is the next one
        ("rossec.renewIdentity", True),
        ("rossec.presentGrants", True),
        ("rossec.unknown", True),
    ],
)
def test_long_calls_without_a_grant_are_for_statements(compact: bool, method: str, taken: bool) -> None:
    client, server = first(compact=compact) if compact else (CallClient("x", compact=False), None)
    server = server or CallServer(compact=False)
    request = server.take(client.request(method, ("/x", b"y" * 2000)))
    assert request is not None
    for load in (server.load, lambda *args: stepped(server, *args)):
        if taken:
            load(request, 1000)
        else:
            with pytest.raises(XmlRpcRefused, match="at most 1000 are taken from a caller"):
                load(request, 1000)
        load(request, 10_000)


def test_what_was_longer_than_anybody_may_send_is_refused() -> None:
    with pytest.raises(XmlRpcRefused, match="a call of 5000000 bytes where at most"):
        CallServer().load(Oversized(5_000_000))

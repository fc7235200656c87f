"""The readers of the compact form as targets: what they take is written again as it came."""

from datetime import datetime

from rossec.errors import CompactRefused
from rossec.ros import calls as compact
from rossec.ros.calls import METHODS, UNPARSED, CallClient, CallServer
from rossec.ros.xmlrpc import Encoded, Fault

_TREE = {
    "a": [1, -2, 300, -70000, 2**31 - 1],
    "rate": 1.5,
    "on": True,
    "off": False,
    "": b"\0\xff",
    "when": datetime.fromisoformat("2026-11-23T09:08:07"),
    "é": {"x" * 30: ["y" * 300]},
}


def call(data: bytes) -> None:
    """A call, the first of a connection."""
    method, params = compact.load_compact_call(data, 0)
    if compact.dump_compact_call(0, method, params) != data:
        raise AssertionError("two encodings of one call")


def answer(data: bytes) -> None:
    """An answer, of any shape."""
    value = compact.load_compact_answer(data, 0, UNPARSED)
    if not isinstance(value, Fault) and compact.dump_compact_answer(0, value) != data:
        raise AssertionError("two encodings of one answer")


def server(data: bytes) -> None:
    """Whatever arrives on a connection, in two pieces: a request, or after a switch a unit."""
    for fed in (CallServer(), _switched_server()):
        for piece in (data[: len(data) // 2], data[len(data) // 2 :]):
            request = fed.take(piece)
            if request is not None:
                fed.load(request)
                fed.respond([1, "", 0])


def client(data: bytes) -> None:
    """Whatever answers a first call, and what follows a switch."""
    for fed in (CallClient("x"), _switched_client()):
        fed.request("getPid", ())
        try:
            fed.take(data)
        except CompactRefused:
            if not fed.closing:
                raise AssertionError("a client goes on after nonsense") from None


def calls() -> list[bytes]:
    """Calls of each method, with every type."""
    return [compact.dump_compact_call(0, method, ("/a", _TREE)) for method in (*METHODS[::8], "later")]


def answers() -> list[bytes]:
    """An answer of each shape."""
    values = ([1, "ok", _TREE], [[1, "", 0]], 5, Fault(1, "no"), Encoded(b"<x/>"))
    return [compact.dump_compact_answer(0, value) for value in values]


def requests() -> list[bytes]:
    """What a client sends: first of all, and then."""
    return [CallClient("x").request("setParam", ("/a", _TREE)), *(_at(1, unit) for unit in calls())]


def responses() -> list[bytes]:
    """What a server sends: first of all, and then."""
    first, old = _first_answer(), CallServer(compact=False)
    old.take(CallClient("x").request("getPid", ()))
    return [first, old.respond([1, "", _TREE]), *(b"%b\x01%b" % (unit[:1], unit[2:]) for unit in answers())]


def _at(turn: int, unit: bytes) -> bytes:
    return unit[:3] + bytes((turn,)) + unit[4:]


def _switched_server() -> CallServer:
    found = CallServer()
    found.take(CallClient("x").request("getPid", ()))
    found.respond([1, "", 7])
    return found


def _first_answer() -> bytes:
    found = CallServer()
    found.take(CallClient("x").request("getPid", ()))
    return found.respond([1, "", 7])


def _switched_client() -> CallClient:
    found = CallClient("x")
    found.request("getPid", ())
    found.take(_first_answer())
    return found

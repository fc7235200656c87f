"""Writes the vectors of the compact form of calls: `tests/vectors/wire/calls.json`.

Run `python -m tests.vectors.make_calls` after a change of the format. Each is one unit with the
number 1. What it means is said by the same call or answer in XML-RPC; without that it has one flaw,
its name, and ends the connection.
"""

import json
from datetime import datetime
from pathlib import Path
from typing import Any, Final

from rossec.ros import calls, xmlrpc
from rossec.ros.compact_values import encoded
from rossec.ros.xmlrpc import Fault
from tests.rossec.ros.test_compactread import REFUSED

FILE: Final = Path(__file__).parent / "wire" / "calls.json"
Vectors = list[dict[str, Any]]
TURN: Final = 1
_API: Final = "http://192.168.1.17:41234/"
_TREE: Final = {
    "i": [0, 23, 24, 255, 256, 65535, 65536, 2**31 - 1, -1, -24, -25, -(2**31)],
    "d": [0.0, -0.0, 1.0, 1.5, 1e300, float("inf"), float("nan")],
    "b": [True, False],
    "text": ["", "é", "x" * 23, "x" * 24, "x" * 256, "\t\n"],
    "bytes": b"\0\xff",
    "time": datetime.fromisoformat("2026-11-23T09:08:07"),
    "empty": [[], {}],
}
CALLS: Final[dict[str, tuple[str, tuple[object, ...]]]] = {
    "no parameters": ("getPid", ()),
    "a number in one byte": ("getParam", ("/a", "/rate")),
    "a number in two bytes": ("getPublishedTopics", ("/a", "")),
    "a method without a number": ("rossec.later", ("/a",)),
    "a registration": ("registerPublisher", ("/a", "/a/t", "std_msgs/String", _API)),
    "every type": ("setParam", ("/a", "/tree", _TREE)),
    "thirty parameters": ("rossec.later", tuple(range(30))),
}
ANSWERS: Final[dict[str, object]] = {
    "a triple": [1, "Parameter [/rate]", 10],
    "a refusal": [-1, "rossec: /a needs the right publish on /t", []],
    "three items that are no triple": ["/n", "text", 1],
    "another value": [[[1, "", 0]], {"faultCode": 1, "faultString": "no"}],
    "a fault": Fault(1, "no such method"),
}


def build() -> Vectors:
    """The content of the file."""
    made = [
        _vector("call", name, calls.dump_compact_call(TURN, *call), xmlrpc.dump_call(*call))
        for name, call in CALLS.items()
    ]
    answers = [
        _vector("answer", name, calls.dump_compact_answer(TURN, value), xmlrpc.dump_response(value))
        for name, value in ANSWERS.items()
    ]
    return [*made, *answers, *(_vector("call", name, unit) for name, unit in flawed().items())]


def flawed() -> dict[str, bytes]:
    """Calls with one flaw."""
    head, good = (bytes.fromhex("86185201") + b"\x01", calls.dump_compact_call(TURN, "getPid", ("/a",)))
    before = head + encoded("/a") + encoded("/p")
    return {
        **{name: before + bytes.fromhex(written) for name, written in REFUSED.items()},
        "41 arrays in one another": before + b"\x81" * 41 + b"\x01",
        "the number before": calls.dump_compact_call(0, "getPid", ("/a",)),
        "the number after": calls.dump_compact_call(2, "getPid", ("/a",)),
        "another mark": good[:2] + b"\x53" + good[3:],
        "a number without a method": good[:4] + b"\x18\x3d" + good[5:],
        "the name of a method that has a number": good[:4] + encoded("getPid") + good[5:],
        "no method": bytes.fromhex("82185201"),
        "two calls": good + good,
    }


def _vector(kind: str, name: str, unit: bytes, meaning: bytes | None = None) -> dict[str, Any]:
    said = {} if meaning is None else {"xml": meaning.decode()}
    return {"name": name, "kind": kind, "data": unit.hex(), **said}


def text() -> str:
    """The file."""
    return json.dumps(build(), indent=1) + "\n"


if __name__ == "__main__":
    FILE.write_text(text())

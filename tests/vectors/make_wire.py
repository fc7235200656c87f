"""Writes the vectors of the channel and of what is inside it: `tests/vectors/wire`.

Run `python -m tests.vectors.make_wire` after a change of the format. Keys, random bytes and
signatures are fixed, so the same program always writes the same files. One vector, one flaw.
"""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

from ca.encoding import Value, encode
from grants.token import pack
from rossec.channel.edhoc.messages import MAX_MESSAGE_1, encode_error, suites_item
from rossec.channel.opening import MAX_DRAIN, MAX_OPENING, WireProtocol, first_bytes
from rossec.channel.records import ChannelLimits, Frame, padded
from rossec.participant.access import MAX_GRANTS
from rossec.ros import tcpros
from rossec.ros.xmlrpc import dump_call
from tests.support.wire import NOW, Wire, alice, bob, wire
from tests.vectors.handshake_vector import handshake
from tests.vectors.make_grants import GOOD

FOLDER: Final = Path(__file__).parent / "wire"
Vectors = list[dict[str, Any]]

_GET: Final = b"GET /rossec HTTP/1.1\r\n"
_X: Final = bytes(range(32))


def openings() -> Vectors:
    """First bytes at a port that accepts both openings, and the result of a responder."""
    request = first_bytes(WireProtocol.HTTP)
    tcpros = first_bytes(WireProtocol.TCPROS)
    accepted = {
        "TCPROS": ("tcpros", tcpros),
        "HTTP": ("http", request),
        "HTTP, other order, other case, spaces": (
            "http",
            _GET + b"UPGRADE:  rossec/1 \r\nHost: x\r\nA: b\r\n\r\n",
        ),
        "HTTP without Connection": ("http", _GET + b"Upgrade: rossec/1\r\n\r\n"),
        "message_1 behind it": ("tcpros", tcpros + b"\x10\x00\x00\x25"),
    }
    plain = {
        "another version": ("tcpros", tcpros[:-1] + b"2", 16),
        "another field": ("tcpros", b"\x09\0\0\0\x05\0\0\0a=bcd", 13),
        "the shortest header": ("tcpros", b"\x05\0\0\0", 9),
        "the longest header": ("tcpros", MAX_DRAIN.to_bytes(4, "little"), 4 + MAX_DRAIN),
        "Upgrade of another version": ("http", _GET + b"Upgrade: rossec/2\r\n\r\n", 43),
        "Upgrade in other letters": ("http", _GET + b"Upgrade: ROSSEC/1\r\n\r\n", 43),
        "no Upgrade": ("http", _GET + b"Host: x\r\n\r\n", 33),
        "another target": ("http", request.replace(b"/rossec", b"/RPC2"), len(request) - 2),
        "another version of HTTP": ("http", request.replace(b"1.1", b"1.0"), len(request)),
        "a call with a body": ("http", b"POST / HTTP/1.1\r\nContent-Length: 5\r\n\r\n12345", 43),
    }
    refused = {
        "a length of 0": bytes(4),
        "a length of 4": b"\x04\0\0\0",
        "a length beyond 1 MiB": (MAX_DRAIN + 1).to_bytes(4, "little"),
        "neither": b"\xff\xff\xff\xff",
        "a field twice": _GET + b"Upgrade: rossec/1\r\nUpgrade: rossec/1\r\n\r\n",
        "a field without colon": _GET + b"Upgrade rossec/1\r\n\r\n",
        "a head that does not end": (_GET + b"A: " + b"a" * MAX_OPENING)[:MAX_OPENING],
    }
    incomplete = {"three bytes": tcpros[:3], "HTTP without its end": request[:-1]}
    return [
        *(
            {"name": name, "data": data.hex(), "verdict": "accepted", "flavour": flavour}
            for name, (flavour, data) in accepted.items()
        ),
        *(
            {"name": name, "data": data.hex(), "verdict": "plain", "flavour": flavour, "drain": drain}
            for name, (flavour, data, drain) in plain.items()
        ),
        *({"name": n, "data": d.hex(), "verdict": "refused"} for n, d in refused.items()),
        *({"name": n, "data": d.hex(), "verdict": "incomplete"} for n, d in incomplete.items()),
    ]


def _message_1(suites: Value = 6, g_x: bytes = _X, c_i: Value = 0, method: Value = 0, *ead: Value) -> bytes:
    return b"".join(map(encode, (method, suites, g_x, c_i, *ead)))


def first_messages() -> Vectors:
    """message_1: its structure and limits alone."""
    room = MAX_MESSAGE_1 - len(_message_1(6, bytes(1000), 0, 0, 1, bytes(300))) + 300
    valid = {
        "usual": _message_1(),
        "of a connection met before": _message_1(c_i=1),
        "16 suites": _message_1([*range(100, 115), 6]),
        "hybrid": _message_1([-24, 6], bytes(1216)),
        "an unknown extension": _message_1(6, _X, 0, 0, 7, b"ignored"),
        "2240 bytes": _message_1(6, bytes(1000), 0, 0, 1, bytes(room)),
    }
    refused = {
        "17 suites": _message_1([*range(100, 116), 6]),
        "one suite in an array": _message_1([6]),
        "no suite": _message_1([]),
        "a suite that is text": _message_1(["6", 6]),
        "a critical extension": _message_1(6, _X, 0, 0, -7, b""),
        "2241 bytes": _message_1(6, bytes(1000), 0, 0, 1, bytes(room + 1)),
        "C_I as a byte string where an integer says the same": _message_1(c_i=b"\x00"),
        "an identifier beyond -24..23": _message_1(c_i=24),
        "a long form": b"\x18\x00" + _message_1()[1:],
        "no identifier": _message_1()[:-1],
    }
    return [
        *({"name": name, "data": data.hex(), "valid": True} for name, data in valid.items()),
        *({"name": name, "data": data.hex(), "valid": False} for name, data in refused.items()),
    ]


def selections() -> Vectors:
    """The result of a responder with a policy for SUITES_I: the suite, or SUITES_R of error 2."""
    cases: list[tuple[str, tuple[int, ...], tuple[int, ...]]] = [
        ("the default", (6,), (6,)),
        ("suite 4 alone", (6,), (4,)),
        ("suite 4 selected, 6 not offered", (6,), (-24, 4)),
        ("6 selected after others it does not use", (6,), (4, -24, 6)),
        ("an earlier suite would have done", (-24, 6), (-24, 6)),
        ("prefer meets prefer", (-24, 6), (-24,)),
        ("prefer meets off", (-24, 6), (6,)),
        ("require meets off", (-24,), (6,)),
        ("off meets require", (6,), (-24,)),
        ("an unknown suite", (6,), (99,)),
    ]
    return [
        {"name": name, "policy": list(policy), "suites_i": list(offered), **_selected(policy, offered)}
        for name, policy, offered in cases
    ]


def _selected(policy: tuple[int, ...], offered: tuple[int, ...]) -> dict[str, Any]:
    usable = [number for number in offered if number in policy]
    if usable and usable[0] == offered[-1]:
        return {"selected": usable[0]}
    suites = (usable[0],) if usable else policy
    return {"error": encode_error(2, suites_item(suites)).hex()}


_PERIOD: Final = 3600
_TIMELINES: Final[dict[str, list[tuple[int, str]]]] = {
    "the hour begins when the connection opens": [(0, "send"), (_PERIOD - 1, "tick"), (_PERIOD, "tick")],
    "a direction without records is not renewed, and its next hour begins": [
        (_PERIOD, "tick"),
        (_PERIOD + 1, "send"),
        (2 * _PERIOD - 1, "tick"),
        (2 * _PERIOD, "tick"),
    ],
    "the next hour begins when the last was over": [
        (0, "send"),
        (_PERIOD + 100, "tick"),
        (_PERIOD + 101, "send"),
        (2 * _PERIOD + 99, "tick"),
        (2 * _PERIOD + 100, "tick"),
    ],
}


def renewals() -> Vectors:
    """When a direction sends REKEY for its age: seconds since the connection opened."""
    return [
        {"name": name, "period": _PERIOD, "steps": _run_timeline(steps)} for name, steps in _TIMELINES.items()
    ]


def _run_timeline(steps: list[tuple[int, str]]) -> Vectors:
    w = _open()
    done: Vectors = []
    for at, what in steps:
        if what == "send":
            w.left.core.send_unit(b"data")
        w.left.core.tick(NOW + at)
        sent = _kinds(w.left.take(), w)
        done.append({"at": at, "do": what, "sends": sent})
    return done


def _open() -> Wire:
    w = wire(alice(limits=replace(ChannelLimits(), seconds=_PERIOD)), bob())
    w.pump()
    return w


def _kinds(data: bytes, w: Wire) -> list[str]:
    """The types of the frames in `data`, which is then passed to the other end."""
    kinds, rest = [], data
    while rest:
        kinds.append(Frame(rest[0] >> 4).name)
        rest = rest[4 + int.from_bytes(rest[1:4]) :]
    w.right.give(data)
    w.pump()
    return kinds


def units() -> Vectors:
    """The content of the first units of a connection: TCPROS headers, XML-RPC calls."""
    several = encode([GOOD, GOOD])
    subscriber = {
        "callerid": b"/heating",
        "topic": b"/robot/pose",
        "type": b"geometry_msgs/PoseStamped",
        "md5sum": b"d3812c3cbc69362b77dc0b19b345f8f5",
    }
    call = dump_call("rossec.presentGrants", ("/heating", several))
    several_grants, no_grants = {"rossec_grants": several}, {"rossec_grants": encode([])}
    return [
        {"name": "a subscriber's header", "data": _framed({**subscriber, **several_grants})},
        {"name": "a subscriber without a grant", "data": _framed({**subscriber, **no_grants})},
        {"name": "rossec.presentGrants of a slave", "data": call.hex()},
    ]


def _framed(fields: dict[str, bytes]) -> str:
    return tcpros.encode(fields).hex()


def presented() -> Vectors:
    """What a peer presents for *subscribe* on /robot/pose, and whether it is sufficient."""
    sufficient, insufficient, malformed = "enough", "not enough", "malformed"
    cases: dict[str, tuple[bytes, str]] = {
        "none": (encode([]), insufficient),
        "one": (encode([GOOD]), sufficient),
        "one that is no grant does not spoil the other": (encode([b"rubbish", GOOD]), sufficient),
        "no grant at all": (encode([b"rubbish"]), insufficient),
        "16": (encode([GOOD] * MAX_GRANTS), sufficient),
        "17": (encode([GOOD] * (MAX_GRANTS + 1)), malformed),
        "a text": (encode([GOOD, "text"]), malformed),
        "no array": (GOOD, malformed),
        "not deterministic": (b"\x98\x00", malformed),
        "beyond 40 KiB": (encode([bytes(40 * 1024)]), malformed),
        "a token whose renewal does not hold": (encode([pack(GOOD, b"t", b"d")]), insufficient),
    }
    return [{"name": name, "data": data.hex(), "verdict": verdict} for name, (data, verdict) in cases.items()]


def paddings() -> Vectors:
    """Plaintexts of PADDED_END: data and what it is padded to; and those that are refused."""
    made: Vectors = []
    for data, multiple in ((b"a", 32), (b"a" * 31, 32), (b"a" * 32, 32), (b"a\1\0", 64)):
        plaintext = padded(data, multiple)
        assert plaintext is not None
        made.append({"data": data.hex(), "multiple": multiple, "plaintext": plaintext.hex()})
    return [
        *made,
        *({"data": None, "plaintext": odd.hex()} for odd in (bytes(32), b"\1".ljust(32, b"\0"), b"ab")),
    ]


def build() -> dict[str, Vectors]:
    """The content of the files, by name."""
    return {
        "openings": openings(),
        "message_1": first_messages(),
        "suites": selections(),
        "handshake": handshake(),
        "rekey": renewals(),
        "units": units(),
        "presented": presented(),
        "padding": paddings(),
    }


def text(vectors: Vectors) -> str:
    """One file."""
    return json.dumps(vectors, indent=1) + "\n"


if __name__ == "__main__":
    FOLDER.mkdir(exist_ok=True)
    for stem, found in build().items():
        (FOLDER / f"{stem}.json").write_text(text(found))

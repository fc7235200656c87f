"""Writes the vectors of the channel and of what is inside it: `tests/vectors/wire`.

Run `python -m tests.vectors.make_wire` after a change of the format. Keys, dice and signatures are
fixed, so the same program always writes the same files. One vector, one flaw.
"""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

from cryptography.hazmat.primitives.asymmetric import x25519

from ca.encoding import Value, encode
from grants.token import pack
from rossec.channel.edhoc.handshake import Initiator, Responder
from rossec.channel.edhoc.keyschedule import (
    EdhocExporter,
    KdfLabel,
    bstr,
    extract,
    kdf,
    transcript_2,
    transcript_next,
)
from rossec.channel.edhoc.messages import (
    MAX_MESSAGE_1,
    Plaintext,
    decode_bytes,
    encode_error,
    suites_item,
)
from rossec.channel.edhoc.peer import C_R, EdhocConfig
from rossec.channel.opening import MAX_DRAIN, MAX_OPENING, WireProtocol, first_bytes
from rossec.channel.records import ChannelLimits, Frame
from rossec.participant.access import MAX_GRANTS
from rossec.ros import header
from rossec.ros.xmlrpc import dump_call
from tests.support.golden import fixed
from tests.support.wire import ALICE, BOB, NOW, FakeIdentity, Wire, alice, bob, dice, trust, wire
from tests.vectors.make_grants import GOOD

FOLDER: Final = Path(__file__).parent / "wire"
Vectors = list[dict[str, Any]]

_GET: Final = b"GET /rossec HTTP/1.1\r\n"
_X: Final = bytes(range(32))


def openings() -> Vectors:
    """First bytes at a port that takes both openings, and what a responder makes of them."""
    request = first_bytes(WireProtocol.HTTP)
    tcpros = first_bytes(WireProtocol.TCPROS)
    accepted = {
        "TCPROS": ("tcpros", tcpros),
        "HTTP": ("http", request),
        "HTTP, other order, other case, spaces": (
            "http", _GET + b"UPGRADE:  rossec/1 \r\nHost: x\r\nA: b\r\n\r\n"
        ),
        "HTTP without Connection": ("http", _GET + b"Upgrade: rossec/1\r\n\r\n"),
        "message_1 behind it": ("tcpros", tcpros + b"\x10\x00\x00\x25"),
    }  # fmt: skip
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
        "a call with a body": (
            "http", b"POST / HTTP/1.1\r\nContent-Length: 5\r\n\r\n12345", 43
        ),
    }  # fmt: skip
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
            {
                "name": name,
                "data": data.hex(),
                "verdict": "plain",
                "flavour": flavour,
                "drain": drain,
            }
            for name, (flavour, data, drain) in plain.items()
        ),
        *({"name": n, "data": d.hex(), "verdict": "refused"} for n, d in refused.items()),
        *({"name": n, "data": d.hex(), "verdict": "incomplete"} for n, d in incomplete.items()),
    ]


def _message_1(
    suites: Value = 6, g_x: bytes = _X, c_i: Value = 0, method: Value = 0, *ead: Value
) -> bytes:
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
    """What a responder with a policy makes of SUITES_I: the suite, or SUITES_R of error 2."""
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
        {
            "name": name,
            "policy": list(policy),
            "suites_i": list(offered),
            **_selected(policy, offered),
        }
        for name, policy, offered in cases
    ]


def _selected(policy: tuple[int, ...], offered: tuple[int, ...]) -> dict[str, Any]:
    usable = [number for number in offered if number in policy]
    if usable and usable[0] == offered[-1]:
        return {"selected": usable[0]}
    suites = (usable[0],) if usable else policy
    return {"error": encode_error(2, suites_item(suites)).hex()}


def _party(end: str) -> EdhocConfig[FakeIdentity]:
    return EdhocConfig(fixed(ALICE if end == "alice" else BOB), trust, dice(end))


def handshake() -> Vectors:
    """One handshake of suite 6 with everything that is computed on the way."""
    messages, _ = spoken()
    values = {**messages, **_schedule(messages["message_1"], messages["message_2"])}
    return [{"name": "suite 6", **{key: value.hex() for key, value in values.items()}}]


def spoken() -> tuple[dict[str, bytes], EdhocExporter]:
    """The four messages, and what they lead to."""
    initiator, responder = Initiator(_party("alice")), Responder(_party("bob"))
    message_1 = initiator.message_1()
    message_2 = responder.message_1(message_1)
    message_3, _ = initiator.message_2(message_2, NOW)
    message_4, _ = responder.message_3(message_3, NOW)
    sent = (message_1, message_2, message_3, message_4)
    return {f"message_{n}": data for n, data in enumerate(sent, 1)}, initiator.exporter


def _schedule(message_1: bytes, message_2: bytes) -> dict[str, bytes]:
    """The key schedule of RFC 9528 section 4, step by step; MAC_2 and MAC_3 have 32 bytes."""
    x, y = dice("alice")(32), dice("bob")(32)
    g_x, g_y = message_1[4:36], decode_bytes(message_2)[:32]
    shared = _exchange(x, g_y)
    th_2 = transcript_2(g_y, message_1)
    prk = extract(th_2, shared)
    left, right = fixed(ALICE), fixed(BOB)
    cred_i, cred_r = bstr(left.certificate), bstr(right.certificate)
    id_i, id_r = encode(left.id_cred), encode(right.id_cred)
    mac_2 = kdf(prk, KdfLabel.MAC_2, C_R + id_r + bstr(th_2) + cred_r, 32)
    sig_2 = right.sign(_signed(id_r, bstr(th_2) + cred_r, mac_2))
    plaintext_2 = Plaintext(C_R, right.id_cred, sig_2).encode()
    th_3 = transcript_next(th_2, plaintext_2, cred_r)
    mac_3 = kdf(prk, KdfLabel.MAC_3, id_i + bstr(th_3) + cred_i, 32)
    sig_3 = left.sign(_signed(id_i, bstr(th_3) + cred_i, mac_3))
    plaintext_3 = Plaintext(None, left.id_cred, sig_3).encode()
    th_4 = transcript_next(th_3, plaintext_3, cred_i)
    exporter = EdhocExporter.derive(prk, th_4)
    context = b"rossec/1" + bytes(8)
    return {
        "x": x, "y": y, "g_x": g_x, "g_y": g_y, "g_xy": shared, "cred_i": cred_i, "cred_r": cred_r,
        "id_cred_i": id_i, "id_cred_r": id_r, "th_2": th_2, "mac_2": mac_2, "signature_2": sig_2,
        "plaintext_2": plaintext_2, "th_3": th_3, "mac_3": mac_3, "signature_3": sig_3,
        "plaintext_3": plaintext_3, "th_4": th_4, "prk_out": exporter.prk_out,
        "key_initiator": exporter.export(32768, context, 16),
        "iv_initiator": exporter.export(32769, context, 12),
        "key_responder": exporter.export(32770, context, 16),
        "iv_responder": exporter.export(32771, context, 12),
    }  # fmt: skip


def _exchange(secret: bytes, public: bytes) -> bytes:
    key = x25519.X25519PrivateKey.from_private_bytes(secret)
    return key.exchange(x25519.X25519PublicKey.from_public_bytes(public))


def _signed(id_cred: bytes, external: bytes, mac: bytes) -> bytes:
    return b"\x84" + encode("Signature1") + bstr(id_cred) + bstr(external) + bstr(mac)


_PERIOD: Final = 3600
_TIMELINES: Final[dict[str, list[tuple[int, str]]]] = {
    "the hour begins when the connection opens": [
        (0, "send"), (_PERIOD - 1, "tick"), (_PERIOD, "tick"),
    ],
    "a direction without records is not renewed, and its next hour begins": [
        (_PERIOD, "tick"), (_PERIOD + 1, "send"), (2 * _PERIOD - 1, "tick"), (2 * _PERIOD, "tick"),
    ],
    "the next hour begins when the last was over": [
        (0, "send"), (_PERIOD + 100, "tick"), (_PERIOD + 101, "send"),
        (2 * _PERIOD + 99, "tick"), (2 * _PERIOD + 100, "tick"),
    ],
}  # fmt: skip


def renewals() -> Vectors:
    """When a direction sends REKEY for its age: seconds since the connection opened."""
    return [
        {"name": name, "period": _PERIOD, "steps": _played(steps)}
        for name, steps in _TIMELINES.items()
    ]


def _played(steps: list[tuple[int, str]]) -> Vectors:
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
    """The types of the frames in `data`, which the other end then takes."""
    kinds, rest = [], data
    while rest:
        kinds.append(Frame(rest[0] >> 4).name)
        rest = rest[4 + int.from_bytes(rest[1:4]) :]
    w.right.give(data)
    w.pump()
    return kinds


def units() -> Vectors:
    """What the first units of a connection hold: headers of TCPROS, calls of XML-RPC."""
    several = encode([GOOD, GOOD])
    subscriber = {
        "callerid": b"/heating",
        "topic": b"/robot/pose",
        "type": b"geometry_msgs/PoseStamped",
        "md5sum": b"d3812c3cbc69362b77dc0b19b345f8f5",
    }
    call = dump_call("rossec.presentGrants", ("/heating", several))
    shown, nothing = {"rossec_grants": several}, {"rossec_grants": encode([])}
    return [
        {"name": "a subscriber's header", "data": _framed({**subscriber, **shown})},
        {"name": "a subscriber without a grant", "data": _framed({**subscriber, **nothing})},
        {"name": "rossec.presentGrants of a slave", "data": call.hex()},
    ]


def _framed(fields: dict[str, bytes]) -> str:
    return header.encode(fields).hex()


def presented() -> Vectors:
    """What a peer shows for *subscribe* on /robot/pose, and whether that is enough."""
    enough, lacking, malformed = "enough", "not enough", "malformed"
    cases: dict[str, tuple[bytes, str]] = {
        "none": (encode([]), lacking),
        "one": (encode([GOOD]), enough),
        "one that is no grant does not spoil the other": (encode([b"rubbish", GOOD]), enough),
        "no grant at all": (encode([b"rubbish"]), lacking),
        "16": (encode([GOOD] * MAX_GRANTS), enough),
        "17": (encode([GOOD] * (MAX_GRANTS + 1)), malformed),
        "a text": (encode([GOOD, "text"]), malformed),
        "no array": (GOOD, malformed),
        "not deterministic": (b"\x98\x00", malformed),
        "beyond 40 KiB": (encode([bytes(40 * 1024)]), malformed),
        "a token whose renewal does not hold": (encode([pack(GOOD, b"t", b"d")]), lacking),
    }
    return [{"name": name, "data": data.hex(), "verdict": so} for name, (data, so) in cases.items()]


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
    }


def text(vectors: Vectors) -> str:
    """One file."""
    return json.dumps(vectors, indent=1) + "\n"


if __name__ == "__main__":
    FOLDER.mkdir(exist_ok=True)
    for stem, found in build().items():
        (FOLDER / f"{stem}.json").write_text(text(found))

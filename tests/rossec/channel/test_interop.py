"""An independent peer (lakers, Rust) and trace 2 of RFC 9529: both method 3, suite 2, by kid.

They check what method 0 shares with method 3: transcript, key schedule, encodings, EAD, message_4,
exporter and key update. lakers encodes exporter labels above 23 wrongly, so the labels are small.
"""

import json
from pathlib import Path

import lakers
import pytest
from cryptography.hazmat.primitives.asymmetric import ec

from ca.encoding import Value, encode
from tests.support.method3 import Method3, Static, fixed, scalar
from tests.support.wire import dice

_VECTORS = json.loads((Path(__file__).parents[2] / "vectors" / "rfc9529.json").read_text())
_TRACE = next(values for name, values in _VECTORS.items() if name.startswith("trace 2"))


def value(name: str, index: int = -1) -> bytes:
    """A value of trace 2 whose name begins so; the last one by default."""
    return bytes.fromhex([v["hex"] for v in _TRACE if v["name"].startswith(name)][index])


def trace_static(who: str, *, secret: bool) -> Static:
    role = {"R": "Responder", "I": "Initiator"}[who]
    key = scalar(value(f"{role}'s private authentication key"))
    kid = value(f"ID_CRED_{who} (CBOR")[-1:]
    return Static(key if secret else key.public_key(), kid, value(f"CRED_{who} (CBOR"))


def trace_sides() -> tuple[Method3, Method3]:
    return (
        Method3(
            trace_static("I", secret=True),
            trace_static("R", secret=False),
            fixed(value("Initiator's ephemeral private key")),
        ),
        Method3(
            trace_static("R", secret=True),
            trace_static("I", secret=False),
            fixed(value("Responder's ephemeral private key")),
        ),
    )


def test_trace_2_byte_for_byte() -> None:
    initiator, responder = trace_sides()
    message = initiator.make_1(b"\x37", (6, 2))
    assert message == value("message_1 (CBOR")
    responder.take_1(message)
    message = responder.make_2()
    assert message == value("message_2 (CBOR")
    initiator.take_2(message)
    message = initiator.make_3()
    assert message == value("message_3 (CBOR")
    responder.take_3(message)
    message = responder.make_4()
    assert message == value("message_4 (CBOR")
    initiator.take_4(message)
    assert initiator.exporter == responder.exporter
    exporter = initiator.exporter
    assert exporter.prk_out == value("PRK_out (Raw")
    assert exporter.export(0, b"", 16) == value("OSCORE Master Secret (Raw")
    updated = exporter.update(value("context for KeyUpdate (Raw"))
    assert updated.prk_out == value("PRK_out after KeyUpdate (Raw")
    assert updated.export(1, b"", 8) == value("OSCORE Master Salt after KeyUpdate (Raw")


# -- lakers


def static(seed: str, kid: bytes) -> Static:
    key = scalar(dice(seed)(31))
    numbers = key.public_key().public_numbers()
    cose_key: dict[int, Value] = {1: 2, 2: kid, -1: 1, -2: numbers.x.to_bytes(32), -3: numbers.y.to_bytes(32)}
    cnf = b"\x08\xa1\x01\xa5" + b"".join(encode(k) + encode(v) for k, v in cose_key.items())
    return Static(key, kid, b"\xa2\x02" + encode(seed) + cnf)


OURS, THEIRS = static("ours.example", b"\x2b"), static("theirs.example", b"\x32")


def secret(who: Static) -> bytes:
    assert isinstance(who.key, ec.EllipticCurvePrivateKey)
    return who.key.private_numbers().private_value.to_bytes(32)


def agree(ours: Method3, theirs: lakers.EdhocInitiator | lakers.EdhocResponder) -> None:
    exporter = ours.exporter
    assert theirs.edhoc_exporter(7, b"context", 40) == exporter.export(7, b"context", 40)
    theirs.edhoc_key_update(b"\x01" * 16)
    updated = exporter.update(b"\x01" * 16)
    assert theirs.edhoc_exporter(0, b"", 16) == updated.export(0, b"", 16)


@pytest.mark.parametrize("ead", [b"", encode(5) + encode(b"value")])
def test_lakers_responds(ead: bytes) -> None:
    ours = Method3(OURS, THEIRS, dice("interop"))
    theirs = lakers.EdhocResponder(secret(THEIRS), THEIRS.cred)
    theirs.process_message_1(ours.make_1())
    eads = [lakers.EADItem(5, False, encode(b"value"))] if ead else []
    ours.take_2(theirs.prepare_message_2(lakers.CredentialTransfer.ByReference, None, eads))
    _, received = theirs.parse_message_3(ours.make_3(ead))
    assert len(received) == len(eads)
    theirs.verify_message_3(lakers.Credential(OURS.cred))
    ours.take_4(theirs.prepare_message_4())
    agree(ours, theirs)


def test_lakers_initiates() -> None:
    ours = Method3(OURS, THEIRS, dice("interop"))
    theirs = lakers.EdhocInitiator()
    ours.take_1(theirs.prepare_message_1())
    theirs.parse_message_2(ours.make_2())
    theirs.verify_message_2(secret(THEIRS), THEIRS.cred, lakers.Credential(OURS.cred))
    message_3, _ = theirs.prepare_message_3(lakers.CredentialTransfer.ByReference)
    ours.take_3(message_3)
    theirs.process_message_4(ours.make_4())
    agree(ours, theirs)

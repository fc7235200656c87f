"""The vectors of the channel: what a second implementation is held against, this one is too."""

import json
from typing import Any

import pytest

from rossec.channel.edhoc.handshake import EdhocConfig, Responder, WrongSuite
from rossec.channel.edhoc.messages import Message1, decode_message_1, encode_error, suites_item
from rossec.channel.opening import Accepted, classify_caller
from rossec.channel.records import unpadded
from rossec.errors import HandshakeFailed, ProtocolViolation
from tests.support.wire import BOB, dice, trust
from tests.vectors import make_wire
from tests.vectors.handshake_vector import exchange_messages


def load(stem: str) -> list[Any]:
    vectors: list[Any] = json.loads((make_wire.FOLDER / f"{stem}.json").read_text())
    assert vectors
    return vectors


def named(stem: str) -> pytest.MarkDecorator:
    return pytest.mark.parametrize("vector", load(stem), ids=lambda vector: vector["name"])


def test_the_files_are_what_the_program_writes() -> None:
    for stem, vectors in make_wire.build().items():
        assert (make_wire.FOLDER / f"{stem}.json").read_text() == make_wire.text(vectors)


def verdict(data: bytes) -> dict[str, object]:
    try:
        found = classify_caller(data)
    except ProtocolViolation:
        return {"verdict": "refused"}
    if found is None:
        return {"verdict": "incomplete"}
    if isinstance(found, Accepted):
        return {"verdict": "accepted", "flavour": found.protocol.value}
    return {"verdict": "plain", "flavour": found.protocol.value, "drain": found.drain}


@named("openings")
def test_openings(vector: dict[str, Any]) -> None:
    said = {key: vector[key] for key in ("verdict", "flavour", "drain") if key in vector}
    assert verdict(bytes.fromhex(vector["data"])) == said


@named("message_1")
def test_message_1(vector: dict[str, Any]) -> None:
    data = bytes.fromhex(vector["data"])
    if vector["valid"]:
        decode_message_1(data)
        return
    with pytest.raises(HandshakeFailed):
        decode_message_1(data)


@named("suites")
def test_suites(vector: dict[str, Any]) -> None:
    policy, offered = tuple(vector["policy"]), tuple(vector["suites_i"])
    length = 1216 if offered[-1] == -24 else 32
    responder = Responder(EdhocConfig(BOB, trust, dice("bob"), policy))
    message = Message1(0, offered, share(length), b"\x00").encode()
    if "error" in vector:
        with pytest.raises(WrongSuite) as wrong:
            responder.on_message_1(message)
        assert encode_error(2, suites_item(wrong.value.suites)).hex() == vector["error"]
        return
    responder.on_message_1(message)
    assert responder.suite.number == vector["selected"]


def share(length: int) -> bytes:
    """A usable G_X; an ML-KEM key of zero coefficients is one."""
    return bytes(length - 32) + bytes(range(1, 33))


@named("handshake")
def test_the_handshake(vector: dict[str, Any]) -> None:
    messages, exporter = exchange_messages()
    assert {name: data.hex() for name, data in messages.items()}.items() <= vector.items()
    assert exporter.prk_out.hex() == vector["prk_out"]  # which depends on everything before it
    assert len(vector["mac_2"]) == len(vector["mac_3"]) == 2 * 32


@named("rekey")
def test_when_keys_are_renewed(vector: dict[str, Any]) -> None:
    rekeys = [step["at"] for step in vector["steps"] if "REKEY" in step["sends"]]
    assert rekeys
    assert all(at >= vector["period"] for at in rekeys)


@pytest.mark.parametrize("vector", load("padding"))
def test_padding(vector: dict[str, Any]) -> None:
    plaintext = bytes.fromhex(vector["plaintext"])
    if vector["data"] is None:
        with pytest.raises(ProtocolViolation):
            unpadded(plaintext)
    else:
        assert unpadded(plaintext) == bytes.fromhex(vector["data"])
        assert len(plaintext) % vector["multiple"] == 0

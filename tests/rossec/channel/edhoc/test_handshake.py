"""Trace 1 of RFC 9529 byte for byte, its invalid messages, and the checks of either side."""

import json
from pathlib import Path
from typing import Any

import pytest
from cryptography.hazmat.primitives.asymmetric import ed25519
from cryptography.hazmat.primitives.asymmetric.x25519 import X25519PrivateKey, X25519PublicKey

from ca.encoding import Value, decode_sequence, encode
from ca.errors import CAError
from rossec.channel.edhoc.handshake import EdhocConfig, Initiator, Responder, WrongSuite
from rossec.channel.edhoc.messages import Message1, decode_bytes, decode_message_1, decode_plaintext
from rossec.channel.edhoc.suites import SUITES
from rossec.errors import HandshakeFailed, IdentityRefused
from tests.support.wire import ALICE, BOB, NOW, FakeIdentity, dice, node, trust

_FILE = Path(__file__).parents[3] / "vectors" / "rfc9529.json"
_VECTORS: dict[str, Any] = json.loads(_FILE.read_text())
_TRACE = next(values for name, values in _VECTORS.items() if name.startswith("trace 1"))
_INVALID = next(values for name, values in _VECTORS.items() if name.startswith("invalid"))


def value(name: str) -> bytes:
    """The one value of trace 1 whose name begins so."""
    found = {v["hex"] for v in _TRACE if v["name"].startswith(name)}
    assert len(found) == 1, (name, found)
    return bytes.fromhex(found.pop())


class TraceIdentity:
    not_after = NOW

    def __init__(self, public_key: ed25519.Ed25519PublicKey) -> None:
        self.public_key = public_key


class TraceCredential:
    """x5t with Ed25519, as the trace has it; rossec itself sends x5chain with ES256."""

    shared = False

    def __init__(self, who: str) -> None:
        key = value({"R": "Responder", "I": "Initiator"}[who] + "'s private authentication key")
        self._key = ed25519.Ed25519PrivateKey.from_private_bytes(key)
        self.id_cred: Value = decode_sequence(value(f"ID_CRED_{who} (CBOR Data Item)"))[0]
        self.certificate = value(f"CRED_{who} (Raw Value)")
        self.public_key = self._key.public_key()
        self.identity = TraceIdentity(self.public_key)
        self.signer = self.current = self

    def sign(self, message: bytes) -> bytes:
        return self._key.sign(message)


def trace_config(own: str, secret: str) -> EdhocConfig[TraceIdentity]:
    credentials = [TraceCredential("I"), TraceCredential("R")]
    return EdhocConfig(
        TraceCredential(own),  # type: ignore[arg-type]  # names no chain
        lambda chain, _: next(c.identity for c in credentials if c.certificate == chain[0]),
        lambda _: value(secret),
        suites=(0,),
        find_chain=lambda id_cred: next((c.certificate,) for c in credentials if c.id_cred == id_cred),
        c_i=value("Connection identifier chosen by Initiator / C_I (Raw"),
        c_r=value("Connection identifier chosen by Responder / C_R (Raw"),
    )


def test_trace_1_byte_for_byte() -> None:
    initiator = Initiator(trace_config("I", "Initiator's ephemeral private key"))
    responder = Responder(trace_config("R", "Responder's ephemeral private key"))
    assert initiator.make_message_1() == value("message_1 (CBOR Sequence)")
    message_2 = responder.on_message_1(initiator.make_message_1())
    assert message_2 == value("message_2 (CBOR Sequence)")
    message_3, _ = initiator.on_message_2(message_2, NOW)
    assert message_3 == value("message_3 (CBOR Sequence)")
    message_4, _ = responder.on_message_3(message_3, NOW)
    assert message_4 == value("message_4 (CBOR Sequence)")
    initiator.on_message_4(message_4)
    exporter = initiator.exporter
    assert exporter == responder.exporter
    assert exporter.prk_out == value("PRK_out (Raw Value)")
    assert exporter.export(0, b"", 16) == value("OSCORE Master Secret (Raw Value)")
    assert exporter.export(1, b"", 8) == value("OSCORE Master Salt (Raw Value)")
    context = value("context for KeyUpdate (Raw Value)")
    updated = exporter.update(context)
    assert updated.prk_out == value("PRK_out after KeyUpdate (Raw Value)")
    assert updated.export(0, b"", 16) == value("OSCORE Master Secret after KeyUpdate (Raw Value)")


# -- the invalid messages of RFC 9529 section 4


def test_the_corpus_is_there() -> None:
    assert len(_INVALID) == 15
    assert len(_TRACE) == 95


@pytest.mark.parametrize("vector", _INVALID, ids=lambda v: v["under"].replace(" ", "-"))
def test_invalid_messages_are_refused(vector: dict[str, str]) -> None:
    data = bytes.fromhex(vector["hex"])
    with pytest.raises(HandshakeFailed):
        _decode(vector, data)


def _decode(vector: dict[str, str], data: bytes) -> None:
    """Feed a vector to the place whose flaw it shows, not to an earlier check."""
    if "PLAINTEXT_2" in vector["name"]:
        decode_plaintext(data, with_c_r=True)
    elif "message_2" in vector["name"]:
        decode_bytes(data)
    elif "low order" in vector["under"]:
        low_order = decode_message_1(data).g_x
        responder = Responder(EdhocConfig(BOB, trust, dice("r"), suites=(0,)))
        responder.on_message_1(Message1(0, (0,), low_order, b"").encode())
    else:
        decode_message_1(data)
        pair()[1].on_message_1(data)  # right structure, flawed P-256 key: no such suite here


# -- either side


def pair(**options: Any) -> tuple[Initiator[FakeIdentity], Responder[FakeIdentity]]:
    return (
        Initiator(EdhocConfig(ALICE, trust, dice("i"), **options)),
        Responder(EdhocConfig(BOB, trust, dice("r"), **options)),
    )


def test_the_exporter_is_shared_and_comes_last() -> None:
    initiator, responder = pair()
    with pytest.raises(HandshakeFailed, match="not finished"):
        _ = responder.exporter
    message_3, peer = initiator.on_message_2(responder.on_message_1(initiator.make_message_1()), NOW)
    assert peer.name == "/bob"
    message_4, peer = responder.on_message_3(message_3, NOW)
    assert peer.name == "/alice"
    initiator.on_message_4(message_4)
    assert initiator.exporter == responder.exporter


@pytest.mark.parametrize("method", [1, 2, 3, 4, -1])
def test_only_method_0_exists(method: int) -> None:
    message = Message1(method, (6,), bytes(range(32)), b"").encode()
    with pytest.raises(HandshakeFailed, match="method"):
        pair()[1].on_message_1(message)


@pytest.mark.parametrize("length", [0, 31, 33, 64])
def test_an_ephemeral_key_of_another_length(length: int) -> None:
    message = Message1(0, (6,), b"\x09" * length, b"").encode()
    with pytest.raises(HandshakeFailed, match="length"):
        pair()[1].on_message_1(message)


@pytest.mark.parametrize("point", [bytes(32), b"\x01" + bytes(31)])
def test_an_ephemeral_key_of_low_order(point: bytes) -> None:
    with pytest.raises(HandshakeFailed, match="not a usable point"):
        pair()[1].on_message_1(Message1(0, (6,), point, b"").encode())
    message_2 = encode(point + bytes(200))
    with pytest.raises(HandshakeFailed, match="not a usable point"):
        pair()[0].on_message_2(message_2, NOW)


def test_ones_own_ephemeral_key_reflected() -> None:
    initiator, _ = pair()
    g_x = decode_message_1(initiator.make_message_1()).g_x
    with pytest.raises(HandshakeFailed, match="reflects"):
        initiator.on_message_2(encode(g_x + bytes(200)), NOW)


@pytest.mark.parametrize("length", [0, 31, 96, 8193])
def test_message_2_of_a_wrong_length(length: int) -> None:
    with pytest.raises(HandshakeFailed, match="length"):
        pair()[0].on_message_2(encode(b"\x09" * length), NOW)


def test_a_chain_that_does_not_fit_into_message_2() -> None:
    long = node("/long")
    heavy = type(long)(long.signer, (long.chain[0], b"x" * 7000, b"y" * 2000))
    initiator, _ = pair()
    responder = Responder(EdhocConfig(heavy, trust, dice("r")))
    with pytest.raises(HandshakeFailed, match="too long") as caught:
        responder.on_message_1(initiator.make_message_1())
    assert "8160" in caught.value.hint


def test_a_chain_of_two_travels_whole() -> None:
    chains = []

    def remember(chain: tuple[bytes, ...], now: int) -> FakeIdentity:
        chains.append(chain)
        return trust(chain, now)

    two = type(BOB)(BOB.signer, (BOB.chain[0], b"intermediate"))
    initiator = Initiator(EdhocConfig(ALICE, remember, dice("i")))
    responder = Responder(EdhocConfig(two, trust, dice("r")))
    initiator.on_message_2(responder.on_message_1(initiator.make_message_1()), NOW)
    assert chains == [two.chain]


def test_a_foreign_signature_is_refused() -> None:
    impostor = type(BOB)(ALICE.signer, BOB.chain)
    initiator, _ = pair()
    message_2 = Responder(EdhocConfig(impostor, trust, dice("r"))).on_message_1(initiator.make_message_1())
    with pytest.raises(HandshakeFailed, match="signature does not verify"):
        initiator.on_message_2(message_2, NOW)


def test_a_refused_certificate_keeps_its_reason_and_hint() -> None:
    def refuse(chain: tuple[bytes, ...], now: int) -> FakeIdentity:
        raise CAError("expired", "renew it")

    initiator = Initiator(EdhocConfig(ALICE, refuse, dice("i")))
    _, responder = pair()
    with pytest.raises(IdentityRefused, match="expired") as caught:
        initiator.on_message_2(responder.on_message_1(initiator.make_message_1()), NOW)
    assert caught.value.hint == "renew it"


def test_an_unknown_extension_is_ignored_and_covered_by_the_signature() -> None:
    ead = encode(40) + encode(b"value") + encode(0)
    initiator = Initiator(EdhocConfig(ALICE, trust, dice("i"), ead=ead))
    responder = Responder(EdhocConfig(BOB, trust, dice("r"), ead=ead))
    message_3, _ = initiator.on_message_2(responder.on_message_1(initiator.make_message_1()), NOW)
    message_4, _ = responder.on_message_3(message_3, NOW)
    initiator.on_message_4(message_4)


@pytest.mark.parametrize("ead", [encode(-40), encode(0) + encode(-1) + encode(b"value")])
def test_a_critical_unknown_extension_ends_the_handshake(ead: bytes) -> None:
    initiator, responder = pair()
    with pytest.raises(HandshakeFailed, match="critical"):
        responder.on_message_1(initiator.make_message_1() + ead)
    _, responder = pair()
    loud = Initiator(EdhocConfig(ALICE, trust, dice("i"), ead=ead))
    message_3, _ = loud.on_message_2(responder.on_message_1(loud.make_message_1()), NOW)
    with pytest.raises(HandshakeFailed, match="critical"):
        responder.on_message_3(message_3, NOW)


# -- suites


@pytest.mark.parametrize(
    ("offered", "supported", "answered"),
    [
        ((4,), (6,), (6,)),
        ((6, 4), (6, 4), (6,)),  # a more preferred one was passed over: downgrade
        ((0, 4), (6, 4, 0), (0,)),
        ((99,), (6, 4), (6, 4)),
    ],
)
def test_the_responder_insists_on_the_first_suite_it_uses(
    offered: tuple[int, ...], supported: tuple[int, ...], answered: tuple[int, ...]
) -> None:
    responder = Responder(EdhocConfig(BOB, trust, dice("r"), suites=supported))
    with pytest.raises(WrongSuite) as caught:
        responder.on_message_1(Message1(0, offered, b"\x09" * 32, b"").encode())
    assert caught.value.suites == answered


def test_a_retry_has_the_whole_list_and_a_new_key() -> None:
    first = Initiator(EdhocConfig(ALICE, trust, dice("i"), suites=(4, 6)))
    second = first.after_wrong_suite((6,))
    before, after = map(decode_message_1, (first.make_message_1(), second.make_message_1()))
    assert before.suites == (4,)
    assert after.suites == (4, 6)
    assert before.g_x != after.g_x


@pytest.mark.parametrize("offered", [(), (4,), (99,)])
def test_no_retry_below_policy(offered: tuple[int, ...]) -> None:
    first = Initiator(EdhocConfig(ALICE, trust, dice("i"), suites=(4, 6)))
    with pytest.raises(HandshakeFailed, match="no cipher suite"):
        first.after_wrong_suite(offered)


def test_keys_of_the_wrong_kind() -> None:
    p256, edwards = ALICE.signer.public_key, TraceCredential("I").identity.public_key
    with pytest.raises(HandshakeFailed, match="not a P-256 key"):
        SUITES[6].verify(edwards, bytes(64), b"")
    with pytest.raises(HandshakeFailed, match="not an Ed25519 key"):
        SUITES[4].verify(p256, bytes(64), b"")
    with pytest.raises(HandshakeFailed, match="does not verify"):
        SUITES[4].verify(edwards, bytes(64), b"")


def test_x25519_agrees_with_the_library() -> None:
    exchange = SUITES[6].exchange
    finish, g_x = exchange.start(dice("a"))
    g_y, shared = exchange.answer(dice("b"), g_x)
    assert finish(g_y) == shared
    own = X25519PrivateKey.from_private_bytes(dice("a")(32))
    assert own.public_key().public_bytes_raw() == g_x
    assert own.exchange(X25519PublicKey.from_public_bytes(g_y)) == shared


def test_a_second_message_2_is_refused() -> None:
    initiator, responder = pair()
    message_2 = responder.on_message_1(initiator.make_message_1())
    initiator.on_message_2(message_2, NOW)
    with pytest.raises(HandshakeFailed, match="second"):
        initiator.on_message_2(message_2, NOW)


# -- every single bit


def flips(data: bytes) -> list[bytes]:
    return [
        data[:index] + bytes([data[index] ^ 1 << bit]) + data[index + 1 :]
        for index in range(len(data))
        for bit in range(8)
    ]


def test_every_flipped_bit_of_message_1_fails_somewhere() -> None:
    for message_1 in flips(pair()[0].make_message_1()):
        initiator, responder = pair()
        with pytest.raises(HandshakeFailed):
            initiator.on_message_2(responder.on_message_1(message_1), NOW)


def test_every_flipped_bit_of_message_2_fails() -> None:
    for index, message_2 in enumerate(flips(pair()[1].on_message_1(pair()[0].make_message_1()))):
        initiator, _ = pair()
        with pytest.raises(HandshakeFailed):
            pytest.fail(f"bit {index}: {initiator.on_message_2(message_2, NOW)}")


def test_every_flipped_bit_of_message_3_and_4_fails() -> None:
    initiator, responder = pair()
    message_3, _ = initiator.on_message_2(responder.on_message_1(initiator.make_message_1()), NOW)
    for flipped in flips(message_3):
        with pytest.raises(HandshakeFailed):
            responder.on_message_3(flipped, NOW)
    message_4, _ = responder.on_message_3(message_3, NOW)
    for flipped in flips(message_4):
        with pytest.raises(HandshakeFailed):
            initiator.on_message_4(flipped)

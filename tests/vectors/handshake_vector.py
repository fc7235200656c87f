"""The vector of one handshake: its messages and every value of its key schedule."""

from typing import Any

from cryptography.hazmat.primitives.asymmetric import x25519

from ca.encoding import encode
from rossec.channel.edhoc.handshake import C_R, EdhocConfig, Initiator, Responder
from rossec.channel.edhoc.messages import Plaintext, decode_bytes
from rossec.channel.edhoc.suites import (
    EdhocExporter,
    KdfLabel,
    bstr,
    extract,
    kdf,
    transcript_2,
    transcript_next,
)
from tests.support.golden import fixed
from tests.support.wire import ALICE, BOB, NOW, FakeIdentity, dice, trust

Vectors = list[dict[str, Any]]


def _party(end: str) -> EdhocConfig[FakeIdentity]:
    return EdhocConfig(fixed(ALICE if end == "alice" else BOB), trust, dice(end))


def handshake() -> Vectors:
    """One handshake of suite 6 with every value computed on the way."""
    messages, _ = exchange_messages()
    values = {**messages, **_schedule(messages["message_1"], messages["message_2"])}
    return [{"name": "suite 6", **{key: value.hex() for key, value in values.items()}}]


def exchange_messages() -> tuple[dict[str, bytes], EdhocExporter]:
    """The four messages, and the resulting exporter."""
    initiator, responder = Initiator(_party("alice")), Responder(_party("bob"))
    message_1 = initiator.make_message_1()
    message_2 = responder.on_message_1(message_1)
    message_3, _ = initiator.on_message_2(message_2, NOW)
    message_4, _ = responder.on_message_3(message_3, NOW)
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
    sig_2 = right.signer.sign(_signed(id_r, bstr(th_2) + cred_r, mac_2))
    plaintext_2 = Plaintext(C_R, right.id_cred, sig_2).encode()
    th_3 = transcript_next(th_2, plaintext_2, cred_r)
    mac_3 = kdf(prk, KdfLabel.MAC_3, id_i + bstr(th_3) + cred_i, 32)
    sig_3 = left.signer.sign(_signed(id_i, bstr(th_3) + cred_i, mac_3))
    plaintext_3 = Plaintext(None, left.id_cred, sig_3).encode()
    th_4 = transcript_next(th_3, plaintext_3, cred_i)
    exporter = EdhocExporter.derive(prk, th_4)
    context = b"rossec/1" + bytes(8)
    return {
        "x": x,
        "y": y,
        "g_x": g_x,
        "g_y": g_y,
        "g_xy": shared,
        "cred_i": cred_i,
        "cred_r": cred_r,
        "id_cred_i": id_i,
        "id_cred_r": id_r,
        "th_2": th_2,
        "mac_2": mac_2,
        "signature_2": sig_2,
        "plaintext_2": plaintext_2,
        "th_3": th_3,
        "mac_3": mac_3,
        "signature_3": sig_3,
        "plaintext_3": plaintext_3,
        "th_4": th_4,
        "prk_out": exporter.prk_out,
        "key_initiator": exporter.export(32768, context, 16),
        "iv_initiator": exporter.export(32769, context, 12),
        "key_responder": exporter.export(32770, context, 16),
        "iv_responder": exporter.export(32771, context, 12),
    }


def _exchange(secret: bytes, public: bytes) -> bytes:
    key = x25519.X25519PrivateKey.from_private_bytes(secret)
    return key.exchange(x25519.X25519PublicKey.from_public_bytes(public))


def _signed(id_cred: bytes, external: bytes, mac: bytes) -> bytes:
    return b"\x84" + encode("Signature1") + bstr(id_cred) + bstr(external) + bstr(mac)

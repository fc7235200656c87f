"""Golden transcripts: every byte of a connection, from fixed keys and randomness.

`python -m tests.support.golden` writes tests/vectors/channel.json; a difference from the
stored file is a change of the wire format, which needs a new protocol version.
"""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.asymmetric.utils import decode_dss_signature

from rossec.channel.edhoc.credentials import Credentials, KnownCertificates
from rossec.channel.opening import WireProtocol
from rossec.channel.records import ChannelLimits
from tests.support.wire import ALICE, BOB, End, Wire, alice, bob, wire

FILE: Final = Path(__file__).parents[1] / "vectors" / "channel.json"
_LIMITS: Final = ChannelLimits(records=3)


@dataclass(frozen=True)
class Deterministic:
    """ES256 with RFC 6979 nonces: the same signature every time."""

    key: ec.EllipticCurvePrivateKey

    @property
    def public_key(self) -> ec.EllipticCurvePublicKey:
        return self.key.public_key()

    def sign(self, message: bytes) -> bytes:
        algorithm = ec.ECDSA(hashes.SHA256(), deterministic_signing=True)
        r, s = decode_dss_signature(self.key.sign(message, algorithm))
        return r.to_bytes(32) + s.to_bytes(32)


def fixed(credentials: Credentials) -> Credentials:
    signer = credentials.signer
    return Credentials(Deterministic(signer._key), credentials.chain)  # type: ignore[attr-defined]  # a KeySigner


def _converse(w: Wire) -> list[dict[str, str]]:
    """Handshake, units both ways, renewals by count, the close; each flight in order."""
    flights: list[dict[str, str]] = []

    def note(end: End, data: bytes) -> bytes:
        flights.append({"from": "I" if end is w.left else "R", "hex": data.hex()})
        return data

    w.meddle = note
    w.pump()
    for number in range(8):
        w.left.core.send_unit(b"from the initiator %d" % number)
        w.right.core.send_unit(b"from the responder", b" %d" % number)
        w.pump()
    w.left.core.close()
    w.pump()
    assert w.left.error is None
    assert w.right.error is None
    return flights


def transcripts() -> dict[str, list[dict[str, str]]]:
    """All transcripts, computed now."""
    left, right = fixed(ALICE), fixed(BOB)

    def talk(
        protocol: WireProtocol, ours: KnownCertificates, theirs: KnownCertificates, request_x5t: bool
    ) -> Wire:
        return wire(
            alice(protocol, left, _LIMITS, known=ours, request_x5t=request_x5t),
            bob(right, _LIMITS, known=theirs),
        )

    ours, theirs = KnownCertificates(), KnownCertificates()
    return {
        "suite 6, TCPROS, x5chain": _converse(talk(WireProtocol.TCPROS, ours, theirs, False)),
        "suite 6, HTTP, x5t": _converse(talk(WireProtocol.HTTP, ours, theirs, True)),
        "suites 4 and 6, error 2": _converse(
            wire(alice(credentials=left, limits=_LIMITS, suites=(4, 6)), bob(right, _LIMITS, suites=(6,)))
        ),
    }


def main() -> None:
    """Store the transcripts that the code produces."""
    FILE.write_text(json.dumps(transcripts(), indent=1) + "\n")


if __name__ == "__main__":
    main()

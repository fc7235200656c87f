"""Writes the vectors of approvals: `python -m tests.vectors.make_approvals`; a test compares them.

Everything follows from fixed inputs, but for ECDSA, whose signatures are random: the vectors have
a signature that was made once, and is verified.
"""

import json
from hashlib import sha256
from pathlib import Path
from typing import Any, Final

from cryptography.hazmat.primitives.asymmetric import ec

from ca.approvals.passkeys import Challenge, Purpose
from ca.approvals.statement import GrantStatement
from tests.support.approving import NOW, WHATS, state
from tests.support.passkeys import ORIGIN, RP_ID, Passkey

FILE: Final = Path(__file__).parent / "approvals" / "approvals.json"
PAYLOAD: Final = b"what will be signed"
GRANT: Final = state(GrantStatement(b"r" * 16, sha256(PAYLOAD).digest()))
CREATION: Final = Challenge(Purpose.PASSKEY, bytes(range(16)), "home", ORIGIN, RP_ID, NOW, NOW + 300)


def device() -> Passkey:
    made = Passkey()
    made.key = ec.derive_private_key(21, ec.SECP256R1())
    made.id = bytes(range(32))
    return made


def vectors() -> dict[str, Any]:
    phone = device()
    registration = phone.register(CREATION.digest)
    assertion = phone.sign(GRANT.challenge)
    return {
        "now": NOW,
        "origin": ORIGIN,
        "rp_id": RP_ID,
        "statements": {
            kind.name.lower(): {
                "statement": state(what).to_bytes().hex(),
                "challenge": state(what).challenge.hex(),
            }
            for kind, what in sorted(WHATS.items())
        },
        "challenges": {purpose: CREATION._replace(purpose=purpose).digest.hex() for purpose in Purpose},
        "registration": {name: data.hex() for name, data in registration._asdict().items()},
        "cose_key": phone.cose_key.hex(),
        "approval": {
            "statement": GRANT.to_bytes().hex(),
            "payload": PAYLOAD.hex(),
            **{name: data.hex() for name, data in assertion._asdict().items()},
        },
    }


if __name__ == "__main__":
    FILE.parent.mkdir(exist_ok=True)
    FILE.write_text(json.dumps(vectors(), indent=1) + "\n")

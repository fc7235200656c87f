"""Writes the vectors of a join: `python -m tests.vectors.make_join`; a test compares them.

Everything follows from fixed inputs, but for ECDSA, whose signatures are random: the vectors have
signatures that were made once, and are verified.
"""

import json
from hashlib import sha256
from pathlib import Path
from typing import Any, Final

from cryptography.hazmat.primitives.asymmetric import ec

from ca.authority import Authority, create_root
from ca.enrollment import invitation
from ca.enrollment.invitation import InvitationCode, JoinClaim, JoinRequest
from ca.enrollment.join import (
    ClaimMessage,
    Hello,
    Issued,
    Join,
    JoinMessage,
    Named,
    RefusedMessage,
    RefuseReason,
    WaitingMessage,
    WaitReason,
    Welcome,
    write,
)
from ca.keys.signing import KeySigner
from ca.svid import build_request

FILE: Final = Path(__file__).parent / "join" / "join.json"
NOW: Final = 1_800_000_000
ROOT, OWN, NODE = (KeySigner(ec.derive_private_key(scalar, ec.SECP256R1())) for scalar in (11, 12, 13))
NODE_NONCE, OWN_NONCE = bytes(range(16)), bytes(range(16, 32))
NAME: Final = "/fleet/robot07"
METADATA: Final = b"<node><group>fleet</group><name>robot07</name></node>"


def code_of(root: bytes) -> InvitationCode:
    return InvitationCode(
        sha256(root).digest(), bytes(range(32, 48)), NOW + 3600, "192.168.1.7:11318", "/fleet/*"
    )


def vectors() -> dict[str, Any]:
    root = create_root(ROOT, "home", now=NOW, serial=1)
    authority = Authority(ROOT, root)
    own = authority.issue(build_request(OWN, "home", "/ca"), now=NOW, serial=2)
    csr = build_request(NODE, "home", NAME)
    leaf = authority.issue(csr, now=NOW, serial=3)
    code = code_of(root)
    agreed = invitation.transcript(code.id, NODE_NONCE, OWN_NONCE, [own], root)
    live = invitation.sign_live(OWN, agreed)
    proof = invitation.sign_proof(code.signer, agreed, csr, NAME)
    claim = invitation.sign_claim(code.signer, agreed, METADATA)
    named_proof = invitation.sign_proof(code.signer, agreed, csr, NAME, METADATA)
    messages: dict[str, JoinMessage] = {
        "hello": Hello(code.id, NODE_NONCE),
        "welcome": Welcome(OWN_NONCE, (own,), root, live),
        "join": Join(NAME, csr, proof),
        "issued": Issued((leaf,)),
        "waiting": WaitingMessage(WaitReason.PERSON),
        "refused": RefusedMessage(RefuseReason.ENDED),
        "claim": ClaimMessage(METADATA, claim),
        "named": Named(NAME),
        "named_join": Join(NAME, csr, named_proof, METADATA),
    }
    return {
        "now": NOW,
        "name": NAME,
        "root": root.hex(),
        "own": own.hex(),
        "csr": csr.hex(),
        "leaf": leaf.hex(),
        "secret": code.secret.hex(),
        "expires": code.expires,
        "address": code.address,
        "pattern": code.pattern,
        "code": code.text(),
        "ndef": invitation.write(code).hex(),
        "key": code.key.hex(),
        "id": code.id.hex(),
        "node_nonce": NODE_NONCE.hex(),
        "own_nonce": OWN_NONCE.hex(),
        "transcript": agreed.hex(),
        "live": live.hex(),
        "proof": proof.hex(),
        "messages": {name: write(message).hex() for name, message in messages.items()},
        "request": JoinRequest(code.id, agreed, NAME, csr, proof).to_bytes().hex(),
        "metadata": METADATA.hex(),
        "claim": JoinClaim(code.id, agreed, METADATA, claim).to_bytes().hex(),
        "named_request": JoinRequest(code.id, agreed, NAME, csr, named_proof, METADATA).to_bytes().hex(),
    }


if __name__ == "__main__":
    FILE.write_text(json.dumps(vectors(), indent=1) + "\n")

"""The published vectors of a join: what the specification says, computed from their inputs."""

import json
from hashlib import sha256

from ca.certificates import TrustAnchor
from ca.enrollment import invitation
from ca.enrollment import invitation as join_transcript
from ca.enrollment import invitation as ndef
from ca.enrollment.invitation import JoinClaim, JoinRequest
from ca.enrollment.join import ClaimMessage, Issued, Join, Named, NodeJoin, Welcome, read, write
from tests.vectors.make_join import FILE

V = json.loads(FILE.read_text())
ROOT, OWN, CSR = (bytes.fromhex(V[name]) for name in ("root", "own", "csr"))
MESSAGES = {name: bytes.fromhex(data) for name, data in V["messages"].items()}


def test_the_code() -> None:
    code = invitation.InvitationCode(
        sha256(ROOT).digest(), bytes.fromhex(V["secret"]), V["expires"], V["address"], V["pattern"]
    )
    assert code.text() == V["code"]
    assert invitation.parse(V["code"]) == code
    assert ndef.write(code).hex() == V["ndef"]
    assert (code.key.hex(), code.id.hex()) == (V["key"], V["id"])


def test_the_transcript_and_what_is_signed_over_it() -> None:
    nonces = bytes.fromhex(V["node_nonce"]), bytes.fromhex(V["own_nonce"])
    agreed = join_transcript.transcript(bytes.fromhex(V["id"]), *nonces, [OWN], ROOT)
    assert agreed.hex() == V["transcript"]
    own = TrustAnchor.load(ROOT).verify([OWN], V["now"])
    join_transcript.check_live(bytes.fromhex(V["live"]), own.public_key, agreed)
    key = invitation.public_key(bytes.fromhex(V["key"]))
    join_transcript.check_proof(bytes.fromhex(V["proof"]), key, agreed, CSR, V["name"])


def test_the_messages() -> None:
    for data in MESSAGES.values():
        assert write(read(data)) == data
    assert isinstance(read(MESSAGES["welcome"]), Welcome)
    assert isinstance(read(MESSAGES["issued"]), Issued)
    request = JoinRequest.from_bytes(bytes.fromhex(V["request"]))
    assert read(MESSAGES["join"]) == Join(request.name, request.csr, request.proof)
    request.verify(bytes.fromhex(V["key"]))


def test_a_claim_and_the_request_that_follows() -> None:
    metadata, key = bytes.fromhex(V["metadata"]), bytes.fromhex(V["key"])
    claim = JoinClaim.from_bytes(bytes.fromhex(V["claim"]))
    claim.verify(key)
    assert read(MESSAGES["claim"]) == ClaimMessage(metadata, claim.proof)
    assert read(MESSAGES["named"]) == Named(V["name"])
    request = JoinRequest.from_bytes(bytes.fromhex(V["named_request"]))
    request.verify(key)
    assert read(MESSAGES["named_join"]) == Join(V["name"], CSR, request.proof, metadata)


def test_a_node_that_is_given_these_messages_joins() -> None:
    node = NodeJoin(invitation.parse(V["code"]), bytes.fromhex(V["node_nonce"]))
    assert node.hello() == MESSAGES["hello"]
    node.receive(MESSAGES["welcome"], V["now"])
    sent, published = read(node.join(CSR)), read(MESSAGES["join"])
    assert isinstance(sent, Join)
    assert isinstance(published, Join)
    assert (sent.name, sent.csr) == (published.name, published.csr)
    node.receive(MESSAGES["issued"], V["now"])
    assert node.identity.chain == (bytes.fromhex(V["leaf"]),)

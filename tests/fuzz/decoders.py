"""What is fuzzed: every decoder of bytes from unauthenticated peers, and of calls, with its seeds.

A target returns, or raises one of our own errors; anything else is a finding. Seeds are real bytes:
messages of a handshake between two connections, of RFC 9529, and of plain peers.
"""

import json
from collections.abc import Callable
from contextlib import suppress
from hashlib import sha256
from pathlib import Path
from typing import Final, TypeAlias

from ca.encoding import decode, encode
from ca.enrollment import invitation, join, qr
from ca.enrollment import invitation as ndef
from ca.enrollment.invitation import InvitationCode, JoinClaim, JoinRequest, sign_claim
from ca.enrollment.join import (
    AuthorityJoin,
    Issued,
    LiveIdentity,
    NodeJoin,
    NodeJoinState,
    RefusedMessage,
    RefuseReason,
    WaitingMessage,
    WaitReason,
)
from ca.enrollment.messages import Delivery, write
from ca.enrollment.sides import AuthorityEnrollment, AuthorityState
from ca.errors import HintedError
from ca.svid import build_request
from rossec.channel.edhoc.credentials import KnownCertificates, reference
from rossec.channel.edhoc.messages import (
    decode_bytes,
    decode_error,
    decode_message_1,
    decode_plaintext,
    decode_plaintext_4,
    encode_error,
)
from rossec.channel.opening import WireProtocol, classify_answer, classify_caller, first_bytes, refusal
from rossec.overlay import link_frames
from rossec.overlay.link import Link
from rossec.overlay.link_frames import LinkFrameKind
from tests.fuzz import compact_calls
from tests.support.enrolling import ADDRESS, Robot, offered
from tests.support.linknet import REPLY, frame, opened
from tests.support.pki import NOW as SOME_TIME
from tests.support.pki import Site, new_signer
from tests.support.wire import ALICE, NOW, joined, receive, wire

Target: TypeAlias = Callable[[bytes], object]

_RFC9529: Final = Path(__file__).parents[1] / "vectors" / "rfc9529.json"
_PLAIN: Final = (
    b"\x10\0\0\0\x0c\0\0\0error=go off",
    b"POST /RPC2 HTTP/1.1\r\nContent-length: 3\r\n\r\nabc",
    b"HTTP/1.0 501 Unsupported\r\n\r\n",
)


def flights() -> list[bytes]:
    """What both sides of a handshake and a short conversation send."""
    w = wire().pump()
    w.left.core.send_unit(b"x" * 300)
    w.right.core.send_unit(b"y", b"z" * 20_000)
    w.pump()
    w.left.core.close()
    w.pump()
    return w.left.sent + w.right.sent


def rfc9529() -> list[bytes]:
    """Every value of the RFC's traces, the invalid ones included."""
    vectors = json.loads(_RFC9529.read_text())
    return [
        bytes.fromhex(vector["hex"])
        for values in vectors.values()
        if isinstance(values, list)
        for vector in values
        if len(vector["hex"]) <= 4096
    ]


def _responder(data: bytes) -> None:
    w = wire()
    receive(w.right.core, data, NOW)


def _initiator(data: bytes) -> None:
    w = wire()
    w.left.take()
    receive(w.left.core, data, NOW)


def _records(data: bytes) -> None:
    """An attacker has no keys: whatever it sends, nothing may be delivered."""
    w = joined()
    with suppress(HintedError):
        events = receive(w.right.core, data, NOW)
        assert events == []


def _credential(data: bytes) -> None:
    KnownCertificates().find(decode(data))


def _openings() -> list[bytes]:
    ours = [first_bytes(flavour) for flavour in WireProtocol]
    return [*ours, *(refusal(flavour) for flavour in WireProtocol), *_PLAIN]


def _credentials() -> list[bytes]:
    certificate = ALICE.chain[0]
    return [encode(ALICE.id_cred), encode(reference(certificate)), encode({33: [b"a", b"b"]})]


ROBOT: Final = Robot()
HOME: Final = Site.create()
LABEL: Final = qr.parse(qr.label_code(ROBOT.csr))
LEAF: Final = HOME.authority.issue(ROBOT.csr, now=SOME_TIME, serial=1)


def enrollments() -> list[bytes]:
    """Every message of an enrollment, and the text of a code."""
    node = ROBOT.enrollment()
    authority, offer = offered(node, HOME)
    answers = node.receive(offer, SOME_TIME)
    node.confirm(node.pending.digits, SOME_TIME)
    delivery = ROBOT.enrollment().receive(authority.fetch(), SOME_TIME)
    return [authority.fetch(), *delivery, offer, *answers, *node.activated()]


def _waiting_authority() -> AuthorityEnrollment:
    authority = AuthorityEnrollment(LABEL, "home")
    authority.receive(write(Delivery(ROBOT.csr)), SOME_TIME)
    authority.approve(SOME_TIME)
    authority.offer([LEAF], HOME.root, bytes(16), SOME_TIME)
    return authority


WAITING: Final = [_waiting_authority()]  # made again only after it failed, because that is slow


def _enrolling_node(data: bytes) -> None:
    ROBOT.enrollment(label=True).receive(data, SOME_TIME)


def _enrolling_authority(data: bytes) -> None:
    fetching = AuthorityEnrollment(LABEL, "home")
    if WAITING[-1].state is not AuthorityState.OFFERED:
        WAITING.append(_waiting_authority())
    for authority in (fetching, WAITING[-1]):
        with suppress(HintedError):
            authority.receive(data, SOME_TIME)
        assert authority.digits == ""


INVITATION: Final = InvitationCode(sha256(HOME.root).digest(), bytes(16), SOME_TIME, ADDRESS, "/robot1/*")
OWN: Final = new_signer()
CA_LEAF: Final = HOME.authority.issue(
    build_request(OWN, "home", "/ca"), now=SOME_TIME, serial=2, lifetime=86400
)
FACE: Final = LiveIdentity(OWN, (CA_LEAF,), HOME.root)


def _session() -> tuple[NodeJoin, AuthorityJoin, bytes]:
    node, face = NodeJoin(INVITATION, bytes(16)), AuthorityJoin(FACE, bytes(16))
    welcome = face.receive(node.hello())
    assert welcome is not None
    return node, face, welcome


def joins() -> list[bytes]:
    """Every message of a join, and the octets that reach the authority's key."""
    node, face, welcome = _session()
    node.receive(welcome, SOME_TIME)
    sent = node.join(ROBOT.csr)
    face.receive(sent)
    answers = Issued((LEAF,)), WaitingMessage(WaitReason.LOCKED), RefusedMessage(RefuseReason.BUSY)
    written = [join.write(answer) for answer in answers]
    return [node.hello(), welcome, sent, *written, face.request.to_bytes()]


def claims() -> list[bytes]:
    """The octets of a claim that reach the authority's key."""
    proof = sign_claim(INVITATION.signer, bytes(32), b"<node/>")
    return [JoinClaim(INVITATION.id, bytes(32), b"<node/>", proof).to_bytes()]


def _joining_node(data: bytes) -> None:
    """Nothing but its own identity is taken, at any moment."""
    fresh = NodeJoin(INVITATION, bytes(15) + b"1")  # a recorded welcome is not for it
    with suppress(HintedError):
        fresh.receive(data, SOME_TIME)
    assert fresh.state is not NodeJoinState.WELCOMED
    node, _, welcome = _session()
    node.receive(welcome, SOME_TIME)
    node.join(ROBOT.csr)
    with suppress(HintedError):
        node.receive(data, SOME_TIME)
    assert node.state is not NodeJoinState.JOINED or node.identity.chain == (LEAF,)


def _joining_authority(data: bytes) -> None:
    _, face, _ = _session()
    face.receive(data)
    face.request.verify(INVITATION.key)


def frames() -> list[bytes]:
    """A frame of each kind, of the link of `tests.support.linknet`."""
    address = link_frames.return_address(REPLY, 560)
    ranges = link_frames.pack_ranges([(20, 30), (40, 50)])
    bodies = (address + b"first", b"bytes", ranges, b"", b"", address)
    return [frame(kind, 50 * (kind != 1), body) for kind, body in zip(LinkFrameKind, bodies, strict=True)]


def _link(data: bytes) -> None:
    """Whoever forges frames can end a link; never more than was allowed is kept or sent."""
    link_frames.refusal(data) if link_frames.link_of(data) else None
    with suppress(HintedError):
        called = Link.accept(data, 0.0)
        called.receive(data, 0.0)
        called.write(bytes(5000), 0.0)
        assert sum(map(len, called.frames_to_send(0.0))) <= 3 * len(data)
    network = opened()
    link = network.called.at()
    received = b"".join(map(bytes, link.receive(data, network.now)))
    assert len(received) <= len(data)
    link.frames_to_send(network.now)


DECODERS: Final[dict[str, tuple[Target, Callable[[], list[bytes]]]]] = {
    "message_1": (decode_message_1, rfc9529),
    "message_2_3_4": (decode_bytes, rfc9529),
    "plaintext_2": (lambda data: decode_plaintext(data, with_c_r=True), rfc9529),
    "plaintext_3": (lambda data: decode_plaintext(data, with_c_r=False), rfc9529),
    "plaintext_4": (decode_plaintext_4, rfc9529),
    "error": (decode_error, lambda: [encode_error(1, "no"), encode_error(2, [6, 4]), b"\x03\xf5"]),
    "credential": (_credential, _credentials),
    "caller": (classify_caller, _openings),
    "answer_tcpros": (lambda data: classify_answer(data, WireProtocol.TCPROS), _openings),
    "answer_http": (lambda data: classify_answer(data, WireProtocol.HTTP), _openings),
    "responder": (_responder, flights),
    "initiator": (_initiator, flights),
    "records": (_records, flights),
    "link": (_link, frames),
    "code": (
        lambda data: qr.parse(data.decode("latin-1")),
        lambda: [ROBOT.enrollment(label=label).code(ADDRESS).encode() for label in (True, False)],
    ),
    "invitation": (
        lambda data: invitation.parse(data.decode("latin-1")),
        lambda: [INVITATION.text().encode()],
    ),
    "ndef": (ndef.read, lambda: [ndef.write(INVITATION)]),
    "join_request": (lambda data: JoinRequest.from_bytes(data).verify(INVITATION.key), joins),
    "join_claim": (lambda data: JoinClaim.from_bytes(data).verify(INVITATION.key), claims),
    "joining_node": (_joining_node, joins),
    "joining_authority": (_joining_authority, joins),
    "enrolling_node": (_enrolling_node, enrollments),
    "enrolling_authority": (_enrolling_authority, enrollments),
    "compact_call": (compact_calls.call, compact_calls.calls),
    "compact_answer": (compact_calls.answer, compact_calls.answers),
    "compact_server": (compact_calls.server, compact_calls.requests),
    "compact_client": (compact_calls.client, compact_calls.responses),
}


def run(name: str, data: bytes) -> None:
    """Feed one input; our own errors are expected."""
    with suppress(HintedError):
        DECODERS[name][0](data)

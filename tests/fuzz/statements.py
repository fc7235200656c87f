"""Every decoder of CBOR, with a valid structure to change, and how to reach it.

A target takes the bytes of a changed structure, signs them where its decoder asks for a signature,
and decodes. It returns, or raises one of our own errors.
"""

from collections.abc import Callable
from contextlib import suppress
from typing import Any, Final, NamedTuple

from cryptography.hazmat.primitives.asymmetric import ec

from ca import certificates
from ca.encoding import decode, encode
from ca.enrollment import NONCE_SIZE, messages, sides
from ca.keys import passphrases
from ca.keys.signing import KeySigner, Profile, Signer, thumbprint
from ca.revocation import lists, trust_status
from ca.revocation import lists as tree
from ca.store import values
from ca.svid import build_request
from grants import document, request, token
from grants import renewal as tickets
from grants.decision import Decision
from grants.errors import GrantError
from grants.filters import layout
from grants.guard import Guard
from grants.model import Draft, Grant, Permission, Restriction, Right, filter_rules, merge
from grants.request import RequestedRight
from rossec.channel.edhoc.credentials import KnownCertificates, reference
from rossec.channel.edhoc.messages import decode_error, decode_message_1, decode_plaintext
from rossec.discovery import announcement
from rossec.master.rights import revocation_lists
from rossec.participant.access import _unpack
from rossec.participant.message_types import message_type
from tests.support.pki import NOW, Site
from tests.support.wire import ALICE

HOME: Final = Site.create(now=NOW - 10 * 86400)
CA: Final = HOME.authority.signer
NODE: Final = KeySigner(ec.generate_private_key(ec.SECP256R1()))
MASTER: Final = KeySigner(ec.generate_private_key(ec.SECP256R1()))
DAY: Final = 86400


class Decoder(NamedTuple):
    """Valid structures, and what takes the bytes of a changed one."""

    seeds: tuple[Any, ...]
    target: Callable[[bytes], object]


def seal(profile: Profile, signer: Signer, body: bytes) -> bytes:
    """`body` under a valid signature."""
    signature = signer.sign(profile._signed_frame + encode(body))
    return b"\xd2" + encode([profile.protected, {}, body, signature])


def framed(data: bytes) -> Any:
    """A statement without its tag."""
    return decode(data[1:], limit=1 << 20)


def payload(profile: Profile, data: bytes) -> Any:
    """The payload of a statement."""
    return profile.peek(data, limit=1 << 20)


# --- grants

PLACE: Final = Restriction(
    "geometry_msgs/PoseStamped",
    ('msg.header.frame_id == "map"', "now < timestamp('2026-11-20T18:00:00Z')"),
    filter_rules(
        {
            "pose.position": {"round": {"step": 0.5, "hysteresis": 0.1}},
            "header.frame_id": {"hash": {"key": "names", "length": 8}},
            "header.seq": {"clear": True},
        }
    ),
    rate=0.5,
    keep_when_stale=True,
)
DRAFT: Final = Draft(
    "home",
    "/heating",
    thumbprint(NODE.public_key),
    NOW - 10,
    NOW + 100,
    NOW + DAY,
    bytes(16),
    (Permission("/pose", Right.SUBSCRIBE, PLACE), Permission("/heating/**", Right.PUBLISH)),
)
GRANT: Final = document.sign(CA, DRAFT)


_POSE: Final = message_type("geometry_msgs/PoseStamped")
POSE: Final = layout.parse(_POSE.name, _POSE.definition)


def _used(grant: Grant) -> None:
    """Use a valid grant: present it, and combine its restrictions."""
    for permission in grant.permissions:
        restriction = permission.restriction
        if restriction is not None:
            restriction.lines()
            restrictions = merge([restriction, PLACE])
            decision = Decision(Right.SUBSCRIBE, "/pose", (grant,), grant.expires, restrictions)
            with suppress(GrantError):
                Guard(POSE, decision, {"names": bytes(32)})(bytes(80), NOW)


def _grant(body: bytes) -> None:
    data = seal(document.GRANT, CA, body)
    _used(document.peek(data))
    _used(document.open_grant(data, CA.public_key, NOW, domain="home"))


def _bare_grant(structure: bytes) -> None:
    document.peek(b"\xd2" + structure)


# --- renewals of grants

DELEGATION: Final = tickets.sign_delegation(
    CA, tickets.Delegation("home", thumbprint(MASTER.public_key), NOW - 10, NOW + DAY, 3600, bytes(16))
)
TICKET: Final = tickets.sign_ticket(MASTER, tickets.Ticket(document.grant_id(GRANT), NOW - 10, NOW + 60, 0))


def _never(_entry: bytes, _now: int) -> None:
    """Nothing is revoked."""


VERIFIER: Final = token.Verifier(CA.public_key, "home", (MASTER.public_key,), 3, _never)


def _delegation(body: bytes) -> None:
    tickets.open_delegation(seal(tickets.DELEGATION, CA, body), CA.public_key)


def _ticket(body: bytes) -> None:
    signed = seal(tickets.TICKET, MASTER, body)
    VERIFIER.open(encode([GRANT, signed, DELEGATION]), NOW)


def _token(structure: bytes) -> None:
    VERIFIER.open(structure, NOW)


# --- revocations

LISTED: Final = lists.RevocationList(1, 2, NOW, NOW + DAY, frozenset({bytes(16), bytes(32), b"\1" * 32}))
LIST: Final = lists.sign_list(CA, LISTED)
TIMESTAMP: Final = lists.sign_timestamp(MASTER, lists.Timestamp(2, lists.digest(LIST), NOW, 30))
LISTING: Final = tree.TreeEntries([bytes([number]) * 32 for number in range(9)])
SIZE, ROOT = LISTING.size_and_root
TREE: Final = tree.RevocationTree(1, 2, NOW, NOW + DAY, SIZE, ROOT)
SIGNED_TREE: Final = tree.sign_tree(CA, TREE)


def _list(body: bytes) -> None:
    held = trust_status.Revocations(CA.public_key)
    held.update(seal(lists.LIST_PROFILE, CA, body), NOW)


def _tree(body: bytes) -> None:
    held = trust_status.Revocations(CA.public_key)
    held.update(seal(tree.TREE, CA, body), NOW)


def _timestamp(body: bytes) -> None:
    held = trust_status.Revocations(CA.public_key)
    held.update(LIST, NOW)
    signed = seal(lists.TIMESTAMP_PROFILE, MASTER, body)
    held.confirm(lists.open_timestamp(signed, MASTER.public_key), NOW)


def _proof(structure: bytes) -> None:
    tree.is_revoked(TREE, b"\3" * 32, structure)


def _absence(structure: bytes) -> None:
    tree.is_revoked(TREE, b"\3" * 16, structure)


def _listing(structure: bytes) -> None:
    tree.TreeEntries.read(structure).check(TREE)


def _listing_seed() -> Any:
    return decode(LISTING.encoded())


# --- the authority's own

HEAD: Final = values.sign_head(CA, values.Head(3, bytes(32), NOW))
MASTER_LEAF: Final = HOME.authority.issue(
    build_request(MASTER, "home", "/master"), now=NOW - 2 * DAY, serial=7, lifetime=3 * DAY
)
NODE_LEAF: Final = HOME.authority.issue(
    build_request(NODE, "home", "/heating"), now=NOW - 2 * DAY, serial=8, lifetime=3 * DAY
)
RENEWAL: Final = certificates.sign_renewal(NODE, [NODE_LEAF], build_request(NODE, "home", "/heating"), NOW)
REQUEST: Final = request.sign_request(
    NODE,
    request.GrantRequest(
        "home", "/heating", NOW, bytes(16), (RequestedRight(Right.SUBSCRIBE, "/pose"),), "to heat"
    ),
)


def _head(body: bytes) -> None:
    values.open_head(seal(values.HEAD_PROFILE, CA, body), CA.public_key)


def _renewal(body: bytes) -> None:
    certificates.open_renewal(seal(certificates.PROFILE, NODE, body), HOME.anchor, NOW, _never)


def _request(body: bytes) -> None:
    signed = seal(request.REQUEST, NODE, body)
    request.open_request(signed, NODE.public_key, domain="home", now=NOW)


def _backup(structure: bytes) -> None:
    passphrases._read_files(structure)


# --- the network

ANNOUNCEMENT: Final = announcement.sign(
    MASTER, (MASTER_LEAF,), announcement.Announcement("robot.local", 11311, bytes(8), 1, NOW)
)


def _announcement(body: bytes) -> None:
    signed = seal(announcement.PROFILE, MASTER, body)
    claim = announcement.read_claim(signed, NOW)
    claim.verify(claim.verify_chain(HOME.anchor, frozenset(), NOW))


def _query(structure: bytes) -> None:
    revocation_lists.RevocationQueries(NOW).answer(bytes(32), frozenset({bytes(16)}), structure)


AGREED: Final = bytes(32)
ACKNOWLEDGED: Final = sides.sign_acknowledgement(NODE, AGREED, bytes(NONCE_SIZE))
DONE: Final = sides.sign_done(NODE, AGREED)


def _acknowledgement(body: bytes) -> None:
    signed = seal(sides._ACKNOWLEDGEMENT, NODE, body)
    sides.open_acknowledgement(signed, NODE.public_key, AGREED)


def _done(body: bytes) -> None:
    sides.check_done(seal(sides._DONE, NODE, body), NODE.public_key, AGREED)


def _sequence(read: Callable[[bytes], object]) -> Callable[[bytes], object]:
    """For what is a CBOR sequence: the items of an array, without its head."""
    return lambda structure: read(structure[1:])


def _credential(structure: bytes) -> None:
    known = KnownCertificates()
    known.remember((ALICE.chain[0],))
    known.find(decode(structure))


OFFER: Final = [1, 3, [NODE_LEAF], HOME.root, bytes(16), bytes(32)]


DECODERS: Final[dict[str, Decoder]] = {
    "grant": Decoder((payload(document.GRANT, GRANT),), _grant),
    "grant unsigned": Decoder((framed(GRANT),), _bare_grant),
    "grants of a header": Decoder(([GRANT, b"x"],), _unpack),
    "delegation": Decoder((payload(tickets.DELEGATION, DELEGATION),), _delegation),
    "ticket": Decoder((payload(tickets.TICKET, TICKET),), _ticket),
    "token": Decoder(([GRANT, TICKET, DELEGATION],), _token),
    "list": Decoder((payload(lists.LIST_PROFILE, LIST),), _list),
    "timestamp": Decoder((payload(lists.TIMESTAMP_PROFILE, TIMESTAMP),), _timestamp),
    "tree": Decoder((payload(tree.TREE, SIGNED_TREE),), _tree),
    "proof": Decoder((decode(LISTING.prove(b"\3" * 32)),), _proof),
    "absence": Decoder((decode(LISTING.prove(b"\3" * 16)),), _absence),
    "listing": Decoder((decode(LISTING.encoded()),), _listing),
    "log head": Decoder((payload(values.HEAD_PROFILE, HEAD),), _head),
    "renewal": Decoder((payload(certificates.PROFILE, RENEWAL),), _renewal),
    "request": Decoder((payload(request.REQUEST, REQUEST),), _request),
    "backup": Decoder(({"ca.pem": b"x", "node/a": b""},), _backup),
    "announcement": Decoder((payload(announcement.PROFILE, ANNOUNCEMENT),), _announcement),
    "query": Decoder(({"diff": 1, "cursor": 2}, {}), _query),
    "enrollment": Decoder(
        ([1, 1], [1, 2, b"csr"], OFFER, [1, 4, b"x"], [1, 5, b"x"], [1, 6, 1]), messages.read
    ),
    "acknowledgement": Decoder((payload(sides._ACKNOWLEDGEMENT, ACKNOWLEDGED),), _acknowledgement),
    "done": Decoder((payload(sides._DONE, DONE),), _done),
    "message_1": Decoder(
        ([3, 6, bytes(32), 14], [3, [6, 24], bytes(32), b"\x18\x18"]), _sequence(decode_message_1)
    ),
    "plaintext_2": Decoder(
        ([14, reference(ALICE.chain[0]), bytes(64), 3, b"x", 4],),
        _sequence(lambda data: decode_plaintext(data, with_c_r=True)),
    ),
    "plaintext_3": Decoder(
        ([{33: ALICE.chain[0]}, bytes(64)],), _sequence(lambda data: decode_plaintext(data, with_c_r=False))
    ),
    "error": Decoder(([1, "no"], [2, [6, 4]], [3, True]), _sequence(decode_error)),
    "credential": Decoder(
        (reference(ALICE.chain[0]), {33: ALICE.chain[0]}, ALICE.id_cred, {33: [b"a", b"b"]}), _credential
    ),
}

"""A test authority, and drafts that differ in one thing."""

from dataclasses import replace
from typing import Any

from cryptography.hazmat.primitives.asymmetric import ec

from ca.encoding import Value
from ca.keys.signing import KeySigner
from grants.document import GRANT, open_grant, sign
from grants.model import Draft, Grant, Permission, Restriction, Right, filter_rules

NOW = 1_800_000_000
HOLDER = bytes(range(32))
CA = KeySigner(ec.generate_private_key(ec.SECP256R1()))
OTHER_CA = KeySigner(ec.generate_private_key(ec.SECP256R1()))

COARSE = Restriction(
    "geometry_msgs/PoseStamped",
    ('msg.header.frame_id == "map"',),
    filter_rules({"pose.position": {"round": {"step": 0.5}}, "header.frame_id": {"clear": True}}),
)
DRAFT = Draft(
    domain="home",
    subject="/heating",
    holder=HOLDER,
    not_before=NOW - 10,
    expires=NOW + 100,
    cap=NOW + 1000,
    serial=bytes(16),
    permissions=(
        Permission("/robot/pose", Right.SUBSCRIBE, COARSE),
        Permission("/heating/**", Right.PUBLISH | Right.PROVIDE),
    ),
)


def draft(*permissions: Permission, **changes: Any) -> Draft:
    """The usual draft with other permissions and claims."""
    return replace(DRAFT, permissions=permissions or DRAFT.permissions, **changes)


def granted(*permissions: Permission, **changes: Any) -> Grant:
    """The usual grant, signed and opened, with other permissions and claims."""
    made = draft(*permissions, **changes)
    return open_grant(sign(CA, made), CA.public_key, made.not_before)


def signed_claims(payload: Value) -> bytes:
    """Any payload, under a good signature of the authority."""
    return GRANT.sign(CA, payload)

"""Writes the vectors of grants: valid ones, and one flaw each with the name of its refusal.

Run `python -m tests.vectors.make_grants` after a change of the format. Keys are fixed and
signatures deterministic (RFC 6979), so the same program always writes the same files.
"""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.asymmetric.utils import decode_dss_signature
from cryptography.hazmat.primitives.serialization import Encoding, PublicFormat

from ca.encoding import Value, decode, encode
from ca.publickey import thumbprint
from grants import document
from grants.model import ALL_RIGHTS, Draft, Permission, Restriction, Right, filter_rules
from grants.renewal import TICKET, Delegation, Ticket, sign_delegation, sign_ticket

FOLDER = Path(__file__).parent / "grants"
NOW = 1_800_000_000


class FixedSigner:
    """Signs the same bytes the same way."""

    def __init__(self, secret: int) -> None:
        self._key = ec.derive_private_key(secret, ec.SECP256R1())

    @property
    def public_key(self) -> ec.EllipticCurvePublicKey:
        return self._key.public_key()

    def sign(self, message: bytes) -> bytes:
        how = ec.ECDSA(hashes.SHA256(), deterministic_signing=True)
        r, s = decode_dss_signature(self._key.sign(message, how))
        return r.to_bytes(32) + s.to_bytes(32)


CA, OTHER, MASTER = FixedSigner(1001), FixedSigner(1002), FixedSigner(1003)

COARSE = Restriction(
    "geometry_msgs/PoseStamped",
    ('msg.header.frame_id == "map"', 'now.getHours("Europe/Zurich") >= 6'),
    filter_rules(
        {
            "pose.position": {"round": {"step": 2.0, "hysteresis": 0.5}},
            "pose.orientation": {"clear": True},
            "header.frame_id": {"hash": {"key": "map", "length": 8}},
        }
    ),
    0.2,
)
DRAFT = Draft(
    "home", "/heating", bytes(range(32)), NOW - 60, NOW + 3600, NOW + 7200, bytes(range(16)),
    (Permission("/robot/pose", Right.SUBSCRIBE, COARSE), Permission("/heating/**", Right.PUBLISH)),
)  # fmt: skip
GOOD = document.sign(CA, DRAFT)
BODY = document.GRANT.peek_body(GOOD)

VALID = {
    "restricted": DRAFT,
    "every right on everything": replace(DRAFT, permissions=(Permission("/**", ALL_RIGHTS),)),
    "parameters": replace(DRAFT, permissions=(Permission("/a/*/b", Right.PARAM_SET),)),
    "only a rate": replace(DRAFT, permissions=(Permission("/a", Right.CALL, Restriction(rate=5)),)),
    "other letters and a far end": replace(
        DRAFT, domain="zuhäuse", not_before=0, expires=1 << 40, cap=1 << 40
    ),
}


def framed(protected: bytes, body: bytes, unprotected: bytes = b"\xa0") -> bytes:
    """A statement whose signature is good, whatever is in it."""
    signature = CA.sign(encode(["Signature1", protected, b"", body]))
    return b"\xd2\x84" + encode(protected) + unprotected + encode(body) + encode(signature)


def header(**changes: Any) -> bytes:
    values: dict[Any, Any] = {1: -7, 2: [16], 16: "rossec-grant+cwt"}
    return encode(values | {int(key[1:]): value for key, value in changes.items()})


def malleated() -> bytes:
    """The other signature of the same grant: valid, with the same id."""
    order = 0xFFFFFFFF00000000FFFFFFFFFFFFFFFFBCE6FAADA7179E84F3B9CAC2FC632551
    return GOOD[:-32] + (order - int.from_bytes(GOOD[-32:])).to_bytes(32)


def frames() -> dict[str, tuple[bytes, str]]:
    """Flaws around the claims."""
    protected = document.GRANT.protected
    other_name = document.GRANT.peek(document.sign(OTHER, DRAFT))
    return {
        "unprotected header": (framed(protected, BODY, b"\xa1\x04\x41\x00"), "GrantForged"),
        "unknown crit": (framed(header(_2=[16, 99], _99=1), BODY), "GrantForged"),
        "other algorithm": (framed(header(_1=-8), BODY), "GrantForged"),
        "other type": (framed(header(_16="rossec-ticket+cwt"), BODY), "GrantForged"),
        "duplicate claim": (framed(protected, b"\xaa\x02\x62/a" + BODY[1:]), "GrantMalformed"),
        "long integer": (
            framed(protected, BODY.replace(b"\x04\x1a", b"\x04\x1b\0\0\0\0", 1)),
            "GrantMalformed",
        ),
        "trailing byte in the claims": (framed(protected, BODY + b"\0"), "GrantMalformed"),
        "trailing byte": (GOOD + b"\0", "GrantMalformed"),
        "indefinite map": (framed(protected, b"\xbf" + BODY[1:] + b"\xff"), "GrantMalformed"),
        "long array header": (b"\xd2\x98\x04" + GOOD[2:], "GrantMalformed"),
        "tag in the claims": (framed(protected, b"\xc1" + BODY), "GrantMalformed"),
        "no tag": (GOOD[1:], "GrantForged"),
        "truncated": (GOOD[:-1], "GrantMalformed"),
        "too large": (framed(protected, BODY + bytes(17000)), "GrantMalformed"),
        "signed by another key": (document.sign(OTHER, DRAFT), "GrantForged"),
        "in the name of another": (document.GRANT.sign(CA, other_name), "GrantForged"),
        "changed byte": (GOOD.replace(b"/heating", b"/heatinh", 1), "GrantForged"),
        "not yet valid": (
            document.sign(CA, replace(DRAFT, not_before=NOW + 1)),
            "GrantNotYetValid",
        ),
        "expired": (document.sign(CA, replace(DRAFT, expires=NOW)), "GrantExpired"),
    }


def flaws() -> dict[str, tuple[bytes, str]]:
    """Flaws in the claims: the same list as in the tests of `grants.claims`."""
    from tests.grants.test_claims import CLAIMS

    claims = decode(BODY)
    return {
        name: (document.GRANT.sign(CA, change(claims)), "GrantMalformed")
        for name, (change, _) in CLAIMS.items()
    }


def renewals() -> list[dict[str, object]]:
    """A delegation and tickets under it; `now` is after the end of the grant."""
    grant, now = document.grant_id(GOOD), DRAFT.expires + 10
    holder = thumbprint(MASTER.public_key)
    delegation = sign_delegation(
        CA, Delegation("home", holder, NOW, NOW + 6000, max_ttl=600, serial=bytes(16))
    )
    good = Ticket(grant, now - 10, now + 500, seq=7)
    tickets = {
        "valid": (sign_ticket(MASTER, good), None),
        "another grant": (sign_ticket(MASTER, replace(good, grant=bytes(16))), "RenewalForOther"),
        "too long": (sign_ticket(MASTER, replace(good, expires=now + 591)), "RenewalTooWide"),
        "beyond the delegation": (
            sign_ticket(MASTER, replace(good, expires=NOW + 6001)),
            "RenewalTooWide",
        ),
        "over": (sign_ticket(MASTER, replace(good, expires=now)), "RenewalNotInTime"),
        "not yet": (sign_ticket(MASTER, replace(good, not_before=now + 1)), "RenewalNotInTime"),
        "newer list": (sign_ticket(MASTER, replace(good, seq=8)), "RenewalAhead"),
        "another signer": (sign_ticket(OTHER, good), "RenewalForged"),
        "a grant": (GOOD, "RenewalForged"),
        "unknown claim": (_ticket_with(good, {9: b""}), "RenewalMalformed"),
    }
    return [
        {
            "name": name, "now": now, "seq": 7, "ca_key": _key(CA), "key": _key(MASTER),
            "grant": GOOD.hex(), "delegation": delegation.hex(), "ticket": data.hex(),
            "failure": failure,
        }
        for name, (data, failure) in tickets.items()
    ]  # fmt: skip


def _ticket_with(ticket: Ticket, more: dict[int | str, Value]) -> bytes:
    claims = TICKET.peek(sign_ticket(MASTER, ticket))
    assert isinstance(claims, dict)
    return TICKET.sign(MASTER, {**claims, **more})


def _key(signer: FixedSigner) -> str:
    return signer.public_key.public_bytes(Encoding.X962, PublicFormat.UncompressedPoint).hex()


def build() -> dict[str, list[dict[str, object]]]:
    """The content of the files, by name."""
    common = {"ca_key": _key(CA), "now": NOW}
    signed = {name: document.sign(CA, draft) for name, draft in VALID.items()}
    signed["malleated signature"] = malleated()
    valid = [
        {"name": name, **common, "data": data.hex(), "id": document.grant_id(data).hex()}
        for name, data in signed.items()
    ]
    refused = [
        {"name": name, **common, "data": data.hex(), "failure": failure}
        for name, (data, failure) in {**frames(), **flaws()}.items()
    ]
    return {"valid": valid, "refused": refused, "renewals": renewals()}


def text(vectors: list[dict[str, object]]) -> str:
    """One file."""
    return json.dumps(vectors, indent=1) + "\n"


if __name__ == "__main__":
    for stem, found in build().items():
        (FOLDER / f"{stem}.json").write_text(text(found))

"""Writes the vectors of grants: valid ones, and one flaw each with the name of its refusal.

Run `python -m tests.vectors.make_grants` after a change of the format. Keys are fixed and
signatures deterministic (RFC 6979), so the same program always writes the same files.
"""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

from cryptography.hazmat.primitives.serialization import Encoding, PublicFormat

from ca.encoding import Value, decode, encode
from ca.keys.signing import thumbprint
from grants import document
from grants.model import ALL_RIGHTS, Draft, Permission, Restriction, Right, filter_rules
from grants.renewal import TICKET, Delegation, Ticket, sign_delegation, sign_ticket
from tests.vectors.narrowings import FixedSigner, chains
from tests.vectors.pictures import pictures

FOLDER = Path(__file__).parent / "grants"
NOW = 1_800_000_000


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
    "home",
    "/heating",
    bytes(range(32)),
    NOW - 60,
    NOW + 3600,
    NOW + 7200,
    bytes(range(16)),
    (Permission("/robot/pose", Right.SUBSCRIBE, COARSE), Permission("/heating/**", Right.PUBLISH)),
)
GOOD = document.sign(CA, DRAFT)
BODY = document.GRANT.peek_body(GOOD)

VALID = {
    "restricted": DRAFT,
    "every right on everything": replace(DRAFT, permissions=(Permission("/**", ALL_RIGHTS),)),
    "parameters": replace(DRAFT, permissions=(Permission("/a/*/b", Right.PARAM_SET),)),
    "only a rate": replace(DRAFT, permissions=(Permission("/a", Right.CALL, Restriction(rate=5)),)),
    "a rate and a slot": replace(
        DRAFT, permissions=(Permission("/a", Right.SUBSCRIBE, Restriction(rate=5, slot=60)),)
    ),
    "padding": replace(DRAFT, permissions=(Permission("/a", Right.SUBSCRIBE, Restriction(pad=256)),)),
    "a domain of 255 bytes": replace(DRAFT, domain="a" * 255),
    "names of anonymous nodes": replace(
        DRAFT,
        subject="/rviz",
        permissions=(Permission("/rviz~/get_loggers", Right.PROVIDE), Permission("/rviz~/**", Right.PUBLISH)),
    ),
    "other letters and a far end": replace(
        DRAFT, domain="zuhäuse", not_before=0, expires=1 << 40, cap=1 << 40
    ),
}


def framed(protected: bytes, body: bytes, unprotected: bytes = b"\xa0") -> bytes:
    """A statement with a valid signature over any content."""
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
        "not yet valid": (document.sign(CA, replace(DRAFT, not_before=NOW + 1)), "GrantNotYetValid"),
        "expired": (document.sign(CA, replace(DRAFT, expires=NOW)), "GrantExpired"),
    }


def flaws() -> dict[str, tuple[bytes, str]]:
    """Flaws in the claims: the same list as in the tests of `grants.document`."""
    from tests.grants.test_claims import CLAIMS

    claims = decode(BODY)
    return {
        name: (document.GRANT.sign(CA, change(claims)), "GrantMalformed")
        for name, (change, _) in CLAIMS.items()
    }


def tokens() -> list[dict[str, object]]:
    """Grants as they are presented: bare, and renewed by the first of `renewals`."""
    renewed = renewals()[0]
    parts = [bytes.fromhex(str(renewed[part])) for part in ("grant", "ticket", "delegation")]
    grant, ticket, delegation = parts
    three = encode([grant, ticket, delegation])
    cases: dict[str, tuple[bytes, str | None]] = {
        "renewed": (three, None),
        "a bare grant that has expired": (grant, "GrantExpired"),
        "two parts": (encode([grant, ticket]), "GrantMalformed"),
        "four parts": (encode([grant, ticket, delegation, b""]), "GrantForged"),
        "an empty part": (encode([grant, b"", delegation]), "GrantMalformed"),
        "a part that is text": (encode([grant, "ticket", delegation]), "GrantMalformed"),
        "another order": (encode([ticket, grant, delegation]), "GrantForged"),
        "a long array header": (b"\x98\x03" + three[1:], "GrantForged"),
        "a trailing byte": (three + b"\0", "GrantMalformed"),
    }
    common = {key: renewed[key] for key in ("ca_key", "key", "now", "seq")}
    return [
        {"name": name, **common, "data": data.hex(), "failure": failure}
        for name, (data, failure) in (cases | chains(CA, DRAFT)).items()
    ]


_GOOD_FILTERS: Final[dict[str, dict[str, Any]]] = {
    "a field": {"a": {"clear": True}},
    "a field of a field": {"a_1.B": {"clear": True}},
    "elements": {"a[*].b[*].c": {"clear": True}},
    "round": {"a": {"round": {"step": 2}}},
    "round with all of it as hysteresis": {"a": {"round": {"step": 0.5, "hysteresis": 0.5}}},
    "clamp to one value": {"a": {"clamp": {"low": 1, "high": 1.0}}},
    "set to a truth value": {"a": {"set": {"value": False}}},
    "truncate to nothing": {"a": {"truncate": {"length": 0}}},
    "truncate, the longest": {"a": {"truncate": {"length": (1 << 32) - 1}}},
    "hash": {"a": {"hash": {"key": "k-1_x", "length": 64}}},
    "hash for each receiver": {"a": {"hash": {"key": "k", "per": "receiver"}}},
    "pixelate": {"data": {"pixelate": {"block": 2}}},
    "pixelate in grey": {"data": {"pixelate": {"block": 32, "levels": 8}}},
    "pixelate by the number of squares": {"data": {"pixelate": {"across": 16, "levels": 8}}},
    "pixelate by both": {"data": {"pixelate": {"across": 65535, "block": 65535}}},
    "rooms": {"a": {"rooms": {"kitchen": "0 0, 4 3", "hall": "4 0,9.5 0, 9 -6.125", "b_2": "0 3, 1 4"}}},
    "rooms with hysteresis": {"a": {"rooms": {"kitchen": "0 0, 4 3", "hysteresis": 0.5}}},
    "sort beside a filter inside": {"a": {"sort": True}, "a[*].b": {"clear": True}},
    "pixelate a region": {
        "data": {"pixelate": {"block": 65535, "x": 0, "y": 0, "width": 1, "height": 65535}}
    },
}
_BAD_FILTERS: Final[dict[str, dict[str, Any]]] = {
    "an empty path": {"": {"clear": True}},
    "a path that begins with a point": {".a": {"clear": True}},
    "a path that ends with a point": {"a.": {"clear": True}},
    "a name that begins with a digit": {"1a": {"clear": True}},
    "a name that begins with _": {"_a": {"clear": True}},
    "another letter": {"\u00e4": {"clear": True}},
    "an index": {"a[0]": {"clear": True}},
    "an element of an element": {"a[*][*]": {"clear": True}},
    "a line end": {"a\n": {"clear": True}},
    "two operators": {"a": {"clear": True, "drop": True}},
    "no operator": {"a": {}},
    "an unknown operator": {"a": {"noise": True}},
    "an operator in other letters": {"a": {"Clear": True}},
    "false for true": {"a": {"clear": False}},
    "a parameter too many": {"a": {"clear": {"x": 1}}},
    "no parameters": {"a": {"round": {}}},
    "a bare parameter": {"a": {"round": 2.0}},
    "a parameter missing": {"a": {"clamp": {"low": 1}}},
    "an unknown parameter": {"a": {"round": {"step": 1, "speed": 2}}},
    "a step of 0": {"a": {"round": {"step": 0}}},
    "a step below 0": {"a": {"round": {"step": -1}}},
    "an infinite step": {"a": {"round": {"step": float("inf")}}},
    "a step that is true": {"a": {"round": {"step": True}}},
    "a step that is text": {"a": {"round": {"step": "1"}}},
    "hysteresis of 0": {"a": {"round": {"step": 1, "hysteresis": 0}}},
    "hysteresis above the step": {"a": {"round": {"step": 1, "hysteresis": 1.5}}},
    "low above high": {"a": {"clamp": {"low": 2, "high": 1}}},
    "redact with a number": {"a": {"redact": {"text": 1}}},
    "truncate below 0": {"a": {"truncate": {"length": -1}}},
    "truncate to 2^32": {"a": {"truncate": {"length": 1 << 32}}},
    "truncate to a fraction": {"a": {"truncate": {"length": 1.5}}},
    "a key in other letters": {"a": {"hash": {"key": "Key"}}},
    "a key with a path": {"a": {"hash": {"key": "../k"}}},
    "a hash of 65 digits": {"a": {"hash": {"key": "k", "length": 65}}},
    "a hash of no digit": {"a": {"hash": {"key": "k", "length": 0}}},
    "a block of 1": {"data": {"pixelate": {"block": 1}}},
    "a block of 65536": {"data": {"pixelate": {"block": 65536}}},
    "no square": {"data": {"pixelate": {"across": 0}}},
    "65536 squares": {"data": {"pixelate": {"across": 65536}}},
    "squares in half": {"data": {"pixelate": {"across": 1.5}}},
    "squares that are text": {"data": {"pixelate": {"across": "16"}}},
    "squares and a block of 1": {"data": {"pixelate": {"across": 16, "block": 1}}},
    "neither squares nor a block": {"data": {"pixelate": {"levels": 8}}},
    "one level of grey": {"data": {"pixelate": {"block": 2, "levels": 1}}},
    "257 levels of grey": {"data": {"pixelate": {"block": 2, "levels": 257}}},
    "a hash for somebody else": {"a": {"hash": {"key": "k", "per": "node"}}},
    "rooms without a room": {"a": {"rooms": {"hysteresis": 1}}},
    "65 rooms": {"a": {"rooms": {f"r{n}": "0 0, 1 1" for n in range(65)}}},
    "a room in other letters": {"a": {"rooms": {"Hall": "0 0, 1 1"}}},
    "a room without corners": {"a": {"rooms": {"hall": ""}}},
    "a room of one corner": {"a": {"rooms": {"hall": "0 0"}}},
    "a room without area": {"a": {"rooms": {"hall": "0 0, 1 1, 2 2"}}},
    "a corner that is no number": {"a": {"rooms": {"hall": "0 0, inf 1"}}},
    "a corner with a plus": {"a": {"rooms": {"hall": "0 0, +1 1"}}},
    "a corner with a zero before": {"a": {"rooms": {"hall": "0 0, 01 1"}}},
    "corners with two spaces": {"a": {"rooms": {"hall": "0 0,  1 1"}}},
    "a room that is a number": {"a": {"rooms": {"hall": 1}}},
    "sort with a parameter": {"a": {"sort": {"by": "b"}}},
    "half a region": {"data": {"pixelate": {"block": 2, "x": 0, "y": 0}}},
}


def filters() -> list[dict[str, object]]:
    """Grants with one filter on /a: errors that are independent of the message type."""
    corpus = ((True, _GOOD_FILTERS), (False, _BAD_FILTERS))
    return [
        {"name": name, "data": _filtering(rules), "valid": valid}
        for valid, named in corpus
        for name, rules in named.items()
    ]


def _filtering(rules: Any) -> str:
    claims: Any = decode(BODY)
    claims[9] = encode([["/a", 2, {0: "p/T", 2: rules}]])
    return document.GRANT.sign(CA, claims).hex()


def truncations() -> list[dict[str, object]]:
    """`truncate` of a string, in bytes; None: the message is dropped."""
    cases: dict[str, tuple[bytes, int, bytes | None]] = {
        "shorter": (b"abc", 5, b"abc"),
        "code points, not bytes": ("\u00e4\u00f6\u00fc".encode(), 2, "\u00e4\u00f6".encode()),
        "beyond 16 bits": ("\U0001f916\U0001f9be".encode(), 1, "\U0001f916".encode()),
        "a combining mark is a code point of its own": ("e\u0301x".encode(), 1, b"e"),
        "nothing left": (b"abc", 0, b""),
        "a sequence that is cut": (b"ab\xc3", 1, None),
        "a byte that is none of UTF-8": (b"a\xff", 1, None),
        "a surrogate": (b"a\xed\xa0\x80", 1, None),
    }
    return [
        {
            "name": name,
            "data": data.hex(),
            "length": length,
            "result": None if result is None else result.hex(),
        }
        for name, (data, length, result) in cases.items()
    ]


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
        "another grant": (sign_ticket(MASTER, replace(good, grant=bytes(16))), "GrantForOther"),
        "too long": (sign_ticket(MASTER, replace(good, expires=now + 591)), "GrantTooWide"),
        "beyond the delegation": (sign_ticket(MASTER, replace(good, expires=NOW + 6001)), "GrantTooWide"),
        "over": (sign_ticket(MASTER, replace(good, expires=now)), "RenewalNotInTime"),
        "not yet": (sign_ticket(MASTER, replace(good, not_before=now + 1)), "RenewalNotInTime"),
        "newer list": (sign_ticket(MASTER, replace(good, seq=8)), "RenewalNotInTime"),
        "another signer": (sign_ticket(OTHER, good), "GrantForged"),
        "a grant": (GOOD, "GrantForged"),
        "unknown claim": (_ticket_with(good, {9: b""}), "GrantMalformed"),
    }
    return [
        {
            "name": name,
            "now": now,
            "seq": 7,
            "ca_key": _key(CA),
            "key": _key(MASTER),
            "grant": GOOD.hex(),
            "delegation": delegation.hex(),
            "ticket": data.hex(),
            "failure": failure,
        }
        for name, (data, failure) in tickets.items()
    ]


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
    return {
        "valid": valid,
        "refused": refused,
        "renewals": renewals(),
        "tokens": tokens(),
        "filters": filters(),
        "pictures": pictures(),
        "truncations": truncations(),
    }


def text(vectors: list[dict[str, object]]) -> str:
    """One file."""
    return json.dumps(vectors, indent=1) + "\n"


if __name__ == "__main__":
    for stem, found in build().items():
        (FOLDER / f"{stem}.json").write_text(text(found))

"""Writes the vectors of things: credentials and statements, each valid or with one flaw.

Run `python -m tests.vectors.make_things` after a change of the format. Keys are fixed and
signatures deterministic (RFC 6979), so the same program always writes the same file.
"""

import json
from pathlib import Path
from typing import Any, Final

from ca.encoding import Value, encode
from ca.keys.signing import Profile, thumbprint
from ca.things import THING, ThingKey, ThingSecret, ThingStatement, peek_statement, sign_statement
from tests.vectors.narrowings import FixedSigner

FILE: Final = Path(__file__).parent / "things" / "things.json"
NOW: Final = 1_800_000_000
YEAR: Final = 365 * 86400
HOME, OTHER, BORDER, LAMP = (FixedSigner(scalar) for scalar in (3001, 3002, 3003, 3004))
SECRET: Final = bytes(range(16))
KEY: Final = ThingKey.of(LAMP.public_key, b"\x2b", "42-50-31-FF-EF-37-32-39")
STATEMENTS: Final = {
    "a key": ThingStatement(
        "home", "/things/lamp", KEY, thumbprint(BORDER.public_key), NOW, NOW + YEAR, bytes(16)
    ),
    "a key without a subject, with a kid of 8 octets": ThingStatement(
        "home",
        "/things/lamp",
        ThingKey.of(LAMP.public_key, b"12345678"),
        thumbprint(BORDER.public_key),
        NOW,
        NOW + 1,
        bytes(range(16)),
    ),
    "a secret": ThingStatement(
        "home",
        "/kitchen/thermometer",
        ThingSecret.of(SECRET, b"\x00\x07"),
        thumbprint(BORDER.public_key),
        0,
        NOW + YEAR,
        bytes(16),
    ),
}
_REFUSED: Final = "ThingRefused"
_OUTDATED: Final = "ThingOutdated"
_X, _Y = KEY.coordinates[:32], KEY.coordinates[32:]


def cose_key(**changes: Value) -> dict[int | str, Value]:
    """The lamp's COSE_Key; `k1` is its label 1, `n2` its label -2; None leaves one out."""
    return _changed({1: 2, 2: b"\x2b", -1: 1, -2: _X, -3: _Y}, changes)


def claims(**changes: Value) -> dict[int | str, Value]:
    """A statement's claims; `c4` is claim 4, `n70035` claim -70035; None leaves one out."""
    known: dict[int | str, Value] = {
        2: "/things/lamp",
        3: "home",
        4: NOW + YEAR,
        5: NOW,
        7: bytes(16),
        8: {1: cose_key()},
        -70035: thumbprint(BORDER.public_key),
    }
    return _changed(known, changes)


def _changed(found: dict[int | str, Value], changes: dict[str, Value]) -> dict[int | str, Value]:
    for name, value in changes.items():
        number = int(name[1:]) * (-1 if name[0] == "n" else 1)
        found[number] = value
        if value is None:
            del found[number]
    return found


FLAWED_KEYS: Final[dict[str, dict[int | str, Value]]] = {
    "without kid": cose_key(k2=None),
    "an empty kid": cose_key(k2=b""),
    "a kid of 9 octets": cose_key(k2=bytes(9)),
    "a number for a kid": cose_key(k2=-12),
    "another type": cose_key(k1=1),
    "another curve": cose_key(n1=2),
    "a truth for a curve": cose_key(n1=True),
    "without y": cose_key(n3=None),
    "a sign for y": cose_key(n3=True),
    "a short x": cose_key(n2=_X[1:]),
    "no point of the curve": cose_key(n3=_X),
    "a private key": cose_key(n4=bytes(32)),
    "an algorithm": cose_key(k3=-7),
}
FLAWED: Final[dict[str, dict[int | str, Value]]] = {
    "a claim is missing": claims(n70035=None),
    "without a domain": claims(c3=None),
    "an unknown claim": claims(n70099=1),
    "another domain": claims(c3="hospital"),
    "an invalid domain": claims(c3="Home"),
    "a relative name": claims(c2="lamp"),
    "a master's name": claims(c2="/master"),
    "the authority's name": claims(c2="/ca"),
    "a relay's name": claims(c2="/relay/attic"),
    "an alias": claims(c2="/remote/hospital/lamp"),
    "never valid": claims(c4=NOW),
    "a truth for a time": claims(c5=True),
    "a time beyond all clocks": claims(c4=1 << 53),
    "a short serial": claims(c7=bytes(15)),
    "a short thumbprint of the router": claims(n70035=bytes(31)),
    "an empty subject": claims(n70040=""),
    "a number for a subject": claims(n70040=1),
    "a subject of 65 octets": claims(n70040="s" * 65),
    "neither key nor secret": claims(c8={}),
    "a thumbprint of a key alone": claims(c8={5: bytes(32)}),
    "a key and a secret": claims(c8={1: cose_key(), 3: b"\x07", 5: bytes(32)}),
    "a secret's kid of 8 octets": claims(c8={3: bytes(8), 5: bytes(32)}),
    "a secret without a kid": claims(c8={3: b"", 5: bytes(32)}),
    "a short thumbprint of a secret": claims(c8={3: b"\x07", 5: bytes(31)}),
    "a secret with a subject": claims(c8={3: b"\x07", 5: bytes(32)}, n70040="lamp"),
    "the secret itself": claims(c8={1: {1: 4, 2: b"\x07", -1: SECRET}}),
    **{f"a key {name}": claims(c8={1: key}) for name, key in FLAWED_KEYS.items()},
}
FLAWED_CREDENTIALS: Final[dict[str, bytes]] = {
    "no CBOR": b"\xff",
    "nothing": b"",
    "not a map": encode([{1: cose_key()}]),
    "no key": encode({2: "lamp"}),
    "an unknown claim": encode({1: "me", 8: {1: cose_key()}}),
    "an empty subject": encode({2: "", 8: {1: cose_key()}}),
    "a number for a subject": encode({2: 1, 8: {1: cose_key()}}),
    "a subject of 65 octets": encode({2: "s" * 65, 8: {1: cose_key()}}),
    "more than 192 octets": encode({2: "s" * 120, 8: {1: cose_key()}}),
    "a second confirmation": encode({8: {1: cose_key(), 3: b"\x2b"}}),
    "an octet after it": KEY.ccs + b"\0",
    "a map of indefinite length": b"\xbf" + KEY.ccs[1:] + b"\xff",
    "a number that is too long": KEY.ccs.replace(b"\x01\x02\x02\x41", b"\x01\x18\x02\x02\x41"),
    **{f"a key {name}": encode({8: {1: key}}) for name, key in FLAWED_KEYS.items()},
}


def vectors() -> dict[str, Any]:
    """The whole file; a refused statement is checked at `now`, for the domain home."""
    valid = {name: sign_statement(HOME, each) for name, each in STATEMENTS.items()}
    return {
        "now": NOW,
        "domain": "home",
        "authority": {"x_y": _coordinates(HOME)},
        "secret": SECRET.hex(),
        "statements": {
            name: {"data": data.hex(), "id": peek_statement(data).id.hex()} for name, data in valid.items()
        },
        "refused": {
            **{name: _refused(THING.sign(HOME, each)) for name, each in FLAWED.items()},
            "another key": _refused(THING.sign(OTHER, claims())),
            "another kind": _refused(Profile("rossec-grant+cwt").sign(HOME, claims())),
            "more than 1024 octets": _refused(THING.sign(HOME, claims(n70040="s" * 1024))),
            "expired": _refused(THING.sign(HOME, claims(c4=NOW, c5=1)), _OUTDATED),
            "not valid yet": _refused(THING.sign(HOME, claims(c5=NOW + 1)), _OUTDATED),
        },
        "credentials": {
            name: each.credential.ccs.hex()
            for name, each in STATEMENTS.items()
            if isinstance(each.credential, ThingKey)
        },
        "refused_credentials": {name: data.hex() for name, data in FLAWED_CREDENTIALS.items()},
    }


def _refused(data: bytes, error: str = _REFUSED) -> dict[str, str]:
    return {"data": data.hex(), "error": error}


def _coordinates(signer: FixedSigner) -> str:
    return ThingKey.of(signer.public_key, b"\0").coordinates.hex()


def main() -> None:
    """Write the file."""
    FILE.parent.mkdir(exist_ok=True)
    FILE.write_text(json.dumps(vectors(), indent=1) + "\n")


if __name__ == "__main__":
    main()

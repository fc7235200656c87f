"""Writes the vectors of foreign domains: lists and bundles, each valid or with one flaw, and chains.

Run `python -m tests.vectors.make_domains` after a change of the format. Keys are fixed and
signatures deterministic (RFC 6979), so the same program always writes the same file.
"""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

from ca.authority import DAY, Authority, create_root
from ca.certificates import TrustAnchor
from ca.domains import (
    DOMAINS,
    TRUST_BUNDLE,
    DomainList,
    ForeignDomain,
    TrustBundle,
    sign_bundle,
    sign_domains,
)
from ca.encoding import Value
from ca.keys.signing import to_coordinates
from ca.svid import build_request
from tests.vectors.narrowings import FixedSigner

FILE: Final = Path(__file__).parent / "domains" / "domains.json"
NOW: Final = 1_800_000_000
HOME, HOSPITAL, OFFICE, ROBOT = (FixedSigner(scalar) for scalar in (2001, 2002, 2003, 2004))
ROOT = create_root(HOME, "home", now=NOW, serial=1)
FOREIGN = create_root(HOSPITAL, "hospital.example", now=NOW, serial=2)
SECOND = create_root(OFFICE, "office", now=NOW, serial=3)
ENTRY = ForeignDomain(
    "hospital.example",
    "hospital",
    FOREIGN,
    ("/master", "/rounds/**"),
    3600,
    NOW + 30 * DAY,
    (("/robot/**", 2),),
    (),
)
OTHER = ForeignDomain("office", "office", SECOND, ("/**",), 604800, NOW + DAY)
MASTERS = tuple(sorted(to_coordinates(each.public_key) for each in (ROBOT, OFFICE)))
LISTS: Final = {
    "no domain, no master": DomainList(1, 1, NOW, NOW + DAY),
    "two domains": DomainList(1, 2, NOW, NOW + DAY, (ENTRY, OTHER)),
    "only masters": DomainList(NOW, 1, NOW, NOW + DAY, (), MASTERS),
    "both": DomainList(1, 3, NOW, NOW + DAY, (ENTRY,), MASTERS),
}
_LIST: Final = "DomainsRefused"
_TRUST_BUNDLE: Final = "BundleRefused"


def claims(**changes: Value) -> dict[int | str, Value]:
    """A list's claims; `c4` is claim 4, `n70001` claim -70001; the first domain's are `d1` ..."""
    entry: dict[int | str, Value] = {
        1: ENTRY.domain,
        2: ENTRY.label,
        3: FOREIGN,
        4: [*ENTRY.admitted],
        5: 3600,
        6: ENTRY.until,
        8: [["/robot/**", 2]],
        9: [],
    }
    found: dict[int | str, Value] = {4: NOW + DAY, 6: NOW, -70001: 1, -70002: 2, -70031: [entry]}
    for name, value in changes.items():
        number = int(name[1:]) * (-1 if name[0] == "n" else 1)
        where = entry if name[0] == "d" else found
        where[number] = value
        if value is None:
            del where[number]
    return found


def second(**changes: Value) -> list[Value]:
    """The list's entry, and one more with `changes`."""
    (first,) = _entries(claims())
    office: dict[str, Value] = {"d1": "office", "d2": "office", "d3": SECOND}
    (more,) = _entries(claims(**(office | changes)))
    return [first, more]


def _entries(found: dict[int | str, Value]) -> list[Value]:
    entries = found[-70031]
    assert isinstance(entries, list)
    return entries


FLAWED: Final[dict[str, dict[int | str, Value]]] = {
    "a field is missing": claims(n70002=None),
    "an unknown field": claims(n70099=1),
    "expires before it is issued": claims(c4=NOW),
    "a truth for a number": claims(n70001=True),
    "no room for masters": claims(n70036=[]),
    "a thumbprint for a master": claims(n70036=[b"t" * 32]),
    "no point of the curve": claims(n70036=[b"t" * 64]),
    "a master twice": claims(n70036=[MASTERS[0], MASTERS[0]]),
    "a domain without a label": claims(d2=None),
    "an unknown field of a domain": claims(d10=1),
    "the own domain": claims(d1="home", d3=ROOT),
    "the own key under another domain": claims(d1="else", d3=create_root(HOME, "else", now=NOW, serial=4)),
    "the root of another domain": claims(d3=SECOND),
    "a leaf for a root": claims(d3=b"\x30\x00"),
    "a label of two words": claims(d2="two/words"),
    "a label that is too long": claims(d2="a" * 33),
    "an invalid domain": claims(d1="Hospital"),
    "admits nobody": claims(d4=[]),
    "a pattern that is none": claims(d4=["/a*"]),
    "a number for a pattern": claims(d4=[1]),
    "too many patterns": claims(d4=[f"/a{number}" for number in range(65)]),
    "fresh for too short a time": claims(d5=29),
    "fresh for too long": claims(d5=7 * DAY + 1),
    "an end at no time": claims(d6=0),
    "an unknown right": claims(d8=[["/a", 256]]),
    "no right": claims(d8=[["/a", 0]]),
    "a rule of one part": claims(d8=[["/a"]]),
    "a rule without a list": claims(d9="/a"),
    "two domains out of order": claims(n70031=second()[::-1]),
    "a domain twice": claims(n70031=second(d1=ENTRY.domain, d3=FOREIGN)),
    "two domains with one label": claims(n70031=second(d2="hospital")),
    "two domains with one root key": claims(
        n70031=second(d3=create_root(HOSPITAL, "office", now=NOW, serial=5))
    ),
}
TRUST_BUNDLES: Final = {
    "without masters": TrustBundle(FOREIGN, ("/**",), (), NOW, NOW + DAY),
    "with masters": TrustBundle(
        FOREIGN, ("/master", "/rounds/**"), ("http://192.168.1.7:11311",), NOW, NOW + 7 * DAY
    ),
}


def bundle_claims(**changes: Value) -> dict[int | str, Value]:
    """A bundle's claims, as `claims`."""
    found: dict[int | str, Value] = {4: NOW + DAY, 6: NOW, -70037: FOREIGN, -70038: ["/**"]}
    for name, value in changes.items():
        number = int(name[1:]) * (-1 if name[0] == "n" else 1)
        found[number] = value
        if value is None:
            del found[number]
    return found


FLAWED_TRUST_BUNDLES: Final[dict[str, dict[int | str, Value]]] = {
    "a field is missing": bundle_claims(c6=None),
    "an unknown field": bundle_claims(n70099=1),
    "a root of another key": bundle_claims(n70037=SECOND),
    "no root": bundle_claims(n70037=b""),
    "no names": bundle_claims(n70038=[]),
    "too many names": bundle_claims(n70038=["/a"] * 17),
    "a name that is none": bundle_claims(n70038=["a"]),
    "a number for a name": bundle_claims(n70038=[1]),
    "no room for masters": bundle_claims(n70039=[]),
    "an address of another scheme": bundle_claims(n70039=["file:///etc/passwd"]),
    "never valid": bundle_claims(c4=NOW),
    "for too long": bundle_claims(c4=NOW + 30 * DAY + 1),
    "expired": bundle_claims(c4=NOW - 1, c6=NOW - DAY),
    "from the future": bundle_claims(c4=NOW + DAY, c6=NOW + 301),
}


def leaf(signer: FixedSigner, root: bytes, name: str, *, wildcard: bool = False) -> bytes:
    """A leaf for the robot's key."""
    csr = build_request(ROBOT, TrustAnchor.load(root).domain, name, wildcard=wildcard)
    return Authority(signer, root).issue(csr, now=NOW, serial=9, wildcard=wildcard)


def chains() -> dict[str, tuple[bytes, str]]:
    """Leaves, and the name that the holder of the list `two domains` gives it, or its refusal."""
    return {
        "own": (leaf(HOME, ROOT, "/robot"), "/robot"),
        "foreign": (leaf(HOSPITAL, FOREIGN, "/rounds/a"), "/remote/hospital/rounds/a"),
        "not admitted": (leaf(HOSPITAL, FOREIGN, "/robot"), "NotAdmitted"),
        "a tail is not honoured": (
            leaf(HOSPITAL, FOREIGN, "/rounds/a", wildcard=True),
            "/remote/hospital/rounds/a",
        ),
        "by the other domain's key": (
            leaf(OFFICE, create_root(OFFICE, "hospital.example", now=NOW, serial=6), "/rounds/a"),
            "ForeignCertificate",
        ),
        "of an unlisted domain": (
            leaf(ROBOT, create_root(ROBOT, "cafe", now=NOW, serial=7), "/rounds/a"),
            "ForeignCertificate",
        ),
        "an own name from outside": (
            leaf(HOSPITAL, create_root(HOSPITAL, "home", now=NOW, serial=8), "/robot"),
            "ForeignCertificate",
        ),
    }


def vectors() -> dict[str, Any]:
    """The whole file."""
    sign: Callable[[dict[int | str, Value]], str] = lambda each: DOMAINS.sign(HOME, each).hex()  # noqa: E731
    return {
        "now": NOW,
        "root": ROOT.hex(),
        "lists": {name: sign_domains(HOME, each, "home").hex() for name, each in LISTS.items()},
        "refused": {
            **{name: {"data": sign(each), "error": _LIST} for name, each in FLAWED.items()},
            "another key": {"data": DOMAINS.sign(HOSPITAL, claims()).hex(), "error": _LIST},
            "another kind": {"data": TRUST_BUNDLE.sign(HOME, claims()).hex(), "error": _LIST},
        },
        "bundles": {name: sign_bundle(HOSPITAL, each).hex() for name, each in TRUST_BUNDLES.items()},
        "refused_bundles": {
            name: {"data": TRUST_BUNDLE.sign(HOSPITAL, each).hex(), "error": _TRUST_BUNDLE}
            for name, each in FLAWED_TRUST_BUNDLES.items()
        },
        "chains": {name: {"leaf": der.hex(), "result": result} for name, (der, result) in chains().items()},
    }


def main() -> None:
    """Write the file."""
    FILE.parent.mkdir(exist_ok=True)
    FILE.write_text(json.dumps(vectors(), indent=1) + "\n")


if __name__ == "__main__":
    main()

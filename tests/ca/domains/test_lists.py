"""The list of foreign domains: strict, one encoding, signed by the own root alone."""

import dataclasses
import json
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from ca import domains as trust
from ca.certificates import TrustAnchor
from ca.domains import DomainList, ForeignDomain, open_domains, sign_domains, verify_domains
from ca.encoding import encode
from ca.errors import CAError, DomainsRefused, EncodingError, NameRefused
from ca.keys.signing import to_coordinates
from tests.support.domains import domains, foreign
from tests.support.pki import NOW, Site, new_signer
from tests.vectors.make_domains import ENTRY, FILE, OTHER

V = json.loads(FILE.read_text())
OWN = TrustAnchor.load(bytes.fromhex(V["root"]))
BOTH = bytes.fromhex(V["lists"]["two domains"])


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("a field is missing", "missing or unknown fields"),
        ("expires before it is issued", "never valid"),
        ("a truth for a number", "out of range"),
        ("a master twice", "not sorted, or has an entry twice"),
        ("a thumbprint for a master", "x and y are expected"),
        ("the own domain", "names the own one"),
        ("the own key under another domain", "this authority's own key"),
        ("the root of another domain", "is that of office"),
        ("a label of two words", "not a label"),
        ("fresh for too short a time", "out of range"),
        ("no right", "unknown or no right on /a"),
        ("a rule of one part", r"not \[pattern, rights\]"),
        ("two domains with one label", "share a label or a root key"),
        ("two domains with one root key", "share a label or a root key"),
        ("another key", "does not verify"),
        ("another kind", "not a statement of kind rossec-domains"),
    ],
)
def test_the_reason_for_a_refusal(name: str, message: str) -> None:
    with pytest.raises(DomainsRefused, match=message):
        open_domains(bytes.fromhex(V["refused"][name]["data"]), OWN)


def test_every_byte_of_a_list_counts() -> None:
    for at in range(0, len(BOTH), 7):
        changed = BOTH[:at] + bytes([BOTH[at] ^ 1]) + BOTH[at + 1 :]
        with pytest.raises(DomainsRefused):
            open_domains(changed, OWN)
        with pytest.raises(DomainsRefused):
            open_domains(BOTH[:at], OWN)
    with pytest.raises(DomainsRefused):
        open_domains(BOTH + b"\0", OWN)


@given(st.binary(max_size=200))
def test_other_bytes_are_no_list(data: bytes) -> None:
    with pytest.raises(DomainsRefused):
        open_domains(data, OWN)


def test_a_list_is_bounded_before_it_is_read() -> None:
    with pytest.raises(DomainsRefused, match="at most"):
        open_domains(BOTH + bytes(trust.MAX_LIST), OWN)
    long = tuple("/" + "a" * 250 + str(number) for number in range(trust.MAX_RULES))
    many = []
    for number in range(5):
        site = Site.create(f"d{number}")
        many.append(foreign(site, f"d{number}", admitted=long))
    with pytest.raises(DomainsRefused, match=r"a list of domains of [0-9]+ bytes, at most 65536"):
        domains(Site.create("home"), *many)


def test_a_signer_refuses_what_a_reader_would() -> None:
    home = Site.create("home")
    with pytest.raises(DomainsRefused, match="names the own one"):
        domains(home, foreign(home, "x"))


def test_another_authority_opens_nothing_of_it() -> None:
    assert verify_domains(BOTH, OWN.public_key).domains == (ENTRY, OTHER)
    with pytest.raises(DomainsRefused, match="does not verify"):
        verify_domains(BOTH, new_signer().public_key)


def test_what_a_list_may_have_at_most() -> None:
    keys = tuple(sorted(to_coordinates(new_signer().public_key) for _ in range(65)))
    assert DomainList(1, 1, NOW, NOW + 1, (), keys[:64]).number == (1, 1)
    with pytest.raises(DomainsRefused, match="too many"):
        DomainList(1, 1, NOW, NOW + 1, (), keys)
    with pytest.raises(DomainsRefused, match="more than 64 exports"):
        dataclasses.replace(ENTRY, exported=(("/a", 1),) * 65)


@pytest.mark.parametrize(
    "change",
    [
        {"fresh": True},
        {"until": True},
        {"until": 1 << 53},
        {"fresh": trust.LEAST_FRESH - 1},
        {"admitted": ()},
        {"label": "a b"},
        {"domain": "office"},
        {"exported": (("a", 1),)},
        {"imported": (("/a", True),)},
    ],
    ids=str,
)
def test_terms_that_are_not_in_form(change: dict[str, Any]) -> None:
    with pytest.raises((DomainsRefused, NameRefused)):
        dataclasses.replace(ENTRY, **change)


def test_terms_are_written_and_read_again() -> None:
    for terms in (ENTRY, OTHER):
        assert ForeignDomain.from_terms(terms.terms) == terms
        assert terms.anchor is terms.anchor  # parsed once
        assert terms.anchor.domain == terms.domain
    with pytest.raises(DomainsRefused, match="missing or unknown"):
        ForeignDomain.from_terms(encode({1: "a"}))
    with pytest.raises(EncodingError):
        ForeignDomain.from_terms(ENTRY.terms[:-1])


def test_one_set_of_domains_has_one_encoding() -> None:
    home = Site.create("home")
    assert OTHER.terms != ENTRY.terms
    with pytest.raises(DomainsRefused, match="not sorted"):
        DomainList(1, 1, NOW, NOW + 1, (OTHER, ENTRY))
    assert ENTRY.terms in domains(home, ENTRY)


def test_a_root_is_parsed_once_for_a_list(monkeypatch: pytest.MonkeyPatch) -> None:
    loaded: list[bytes] = []
    load = TrustAnchor.load.__func__  # type: ignore[attr-defined]

    def counted(cls: type[TrustAnchor], der: bytes) -> TrustAnchor:
        loaded.append(der)
        found: TrustAnchor = load(cls, der)
        return found

    monkeypatch.setattr(TrustAnchor, "load", classmethod(counted))
    assert len(open_domains(BOTH, OWN).domains) == 2
    assert loaded == [ENTRY.root, OTHER.root]


def test_signing_needs_a_list_in_form() -> None:
    with pytest.raises(CAError):
        sign_domains(new_signer(), DomainList(-1, 1, NOW, NOW + 1), "home")

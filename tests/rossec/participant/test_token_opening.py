"""Tokens of the own domain and of a foreign one: by whose root, list and masters they open."""

from dataclasses import replace
from typing import Any

import pytest

from ca.encoding import encode
from ca.errors import Revoked
from ca.keys.signing import KeySigner, thumbprint, to_coordinates
from grants.document import grant_id
from grants.errors import GrantError, GrantForOther, GrantMalformed, GrantMissing, GrantNotHeld, GrantRevoked
from grants.model import Grant, Right
from grants.renewal import Delegation, Ticket, sign_delegation, sign_ticket
from grants.token import pack
from rossec.participant import access
from rossec.participant.access import TokenOpener
from tests.support.domains import Pair, SomeNode, domains, foreign, grant
from tests.support.pki import DAY, NOW, Site

DOMAIN = "hospital.example"
HOLDER = bytes(32)


@pytest.fixture
def pair() -> Pair:
    pair = Pair()
    pair.confirm_own()
    pair.confirm_foreign()
    return pair


def renewed(site: Site, master: SomeNode) -> bytes:
    """A grant that has expired, renewed by a master."""
    times: dict[str, Any] = {"not_before": NOW - 100, "expires": NOW - 10, "cap": NOW + DAY}
    token = grant(site, HOLDER, Right.SUBSCRIBE, "/x", **times)
    delegation = Delegation(
        site.anchor.domain, master.identity.thumbprint, NOW - 100, NOW + DAY, 3600, bytes(16)
    )
    return pack(
        token,
        sign_ticket(master.signer, Ticket(grant_id(token), NOW, NOW + 60, 1)),
        sign_delegation(KeySigner(site.key), delegation),
    )


def test_a_token_is_of_the_domain_that_is_asked_for(pair: Pair) -> None:
    opener = TokenOpener(pair.trust_status)
    ours, theirs = (grant(site, HOLDER, Right.SUBSCRIBE, "/x") for site in (pair.home, pair.hospital))
    assert opener.open(ours, "home", NOW).domain == "home"
    assert opener.open(theirs, DOMAIN, NOW).domain == DOMAIN
    for token, domain in ((ours, DOMAIN), (theirs, "home")):
        with pytest.raises(GrantError):
            opener.open(token, domain, NOW)
    with pytest.raises(GrantMissing, match="'elsewhere', which is not listed"):
        opener.open(ours, "elsewhere", NOW)


def test_what_is_refused_is_left_out(pair: Pair) -> None:
    opener, good = TokenOpener(pair.trust_status), grant(pair.home, HOLDER, Right.CALL, "/x")
    peer = pair.own_master.identity
    found, refused = opener.open_all(encode([b"garbage", good]), "home", peer, NOW)
    assert [each.id for each in found] == [grant_id(good)]
    assert len(refused) == 1
    with pytest.raises(GrantMalformed):
        opener.open_all(b"\xff", "home", peer, NOW)


def test_tickets_of_the_own_domain_count_from_its_masters(pair: Pair) -> None:
    opener, kitchen = TokenOpener(pair.trust_status), SomeNode(pair.home, "/master/kitchen")
    by_own, by_kitchen = renewed(pair.home, pair.own_master), renewed(pair.home, kitchen)
    for token in (by_own, by_kitchen):
        with pytest.raises(GrantForOther):
            opener.open(token, "home", NOW)
    opener.own_master = pair.own_master.key
    assert opener.open(by_own, "home", NOW).expires == NOW + 60
    with pytest.raises(GrantForOther):
        opener.open(by_kitchen, "home", NOW)
    keys = (to_coordinates(kitchen.key),)
    pair.anchors.update(domains(pair.home, foreign(pair.hospital), seq=2, masters=keys))
    assert opener.open(by_kitchen, "home", NOW).expires == NOW + 60
    pair.confirm_own(kitchen.identity.thumbprint, seq=2)
    with pytest.raises((GrantForOther, GrantRevoked)):
        opener.open(by_kitchen, "home", NOW)


def test_tickets_of_a_foreign_domain_count_from_the_masters_that_were_seen(pair: Pair) -> None:
    opener, other = TokenOpener(pair.trust_status), SomeNode(pair.hospital, "/master/ward")
    opener.own_master = pair.own_master.key
    assert opener.open(renewed(pair.hospital, pair.master), DOMAIN, NOW).expires == NOW + 60
    for token in (renewed(pair.hospital, other), renewed(pair.hospital, pair.own_master)):
        with pytest.raises(GrantForOther):
            opener.open(token, DOMAIN, NOW)
    pair.confirm_foreign(pair.master.identity.thumbprint[:16], seq=2)
    token = renewed(pair.hospital, pair.master)
    assert opener.open(token, DOMAIN, NOW).via[1] == thumbprint(pair.master.key)


def test_an_entry_is_checked_on_each_list_that_counts(pair: Pair) -> None:
    opener, here, there = TokenOpener(pair.trust_status), b"h" * 16, b"t" * 16
    pair.confirm_own(here, seq=2)
    pair.confirm_foreign(there, seq=2)
    opener.check_of("home")(there, NOW)
    for entry in (here, there):
        with pytest.raises(Revoked):
            opener.check_of("home", DOMAIN)(entry, NOW)
        with pytest.raises(Revoked):
            opener.check_of(DOMAIN)(entry, NOW)


def test_a_token_is_verified_once_and_few_are_remembered(pair: Pair, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(access, "CACHE_SIZE", 2)
    opener, peer = TokenOpener(pair.trust_status), pair.own_master.identity
    opened: list[bytes] = []
    verify = opener.open

    def record(token: bytes, domain: str, now: int) -> Grant:
        opened.append(token)
        return verify(token, domain, now)

    monkeypatch.setattr(opener, "open", record)
    tokens = [grant(pair.home, HOLDER, Right.CALL, f"/x{number}") for number in range(3)]
    for token in (tokens[0], tokens[0], tokens[1], tokens[2], tokens[0]):
        opener.open_all(encode([token]), "home", peer, NOW)
    assert opened == [*tokens, tokens[0]]


def test_a_tail_pattern_opens_for_the_tail_alone_also_when_it_was_opened_before(pair: Pair) -> None:
    """Of a foreigner the tail is not honoured, whatever its own authority signed."""
    opener, peer = TokenOpener(pair.trust_status), SomeNode(pair.home, "/rviz").identity
    tail = replace(peer, wildcard=True)
    token = grant(pair.home, peer.thumbprint, Right.PROVIDE, "/rviz~/a", subject="/rviz")
    for who, opens in ((tail, True), (peer, False), (replace(tail, name="/rviz_1"), False)):
        found, refused = opener.open_all(encode([token]), "home", who, NOW)
        assert [len(found), len(refused)] == ([1, 0] if opens else [0, 1])
        assert all(isinstance(error, GrantNotHeld) for error in refused)
    theirs = grant(pair.hospital, HOLDER, Right.PROVIDE, "/rounds/robot3~/a", subject="/rounds/robot3")
    found, (error,) = opener.open_all(encode([theirs]), DOMAIN, pair.peer(), NOW)
    assert found == []
    assert isinstance(error, GrantNotHeld)

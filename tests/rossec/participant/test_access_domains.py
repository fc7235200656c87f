"""`Access` with foreign domains: whose grants decide on a name, and whose revocations end it."""

import pytest

from ca.domains import Anchors
from ca.encoding import Value, encode
from ca.errors import NameRefused, NotAdmitted, RevocationsStale, Revoked
from ca.keys.signing import thumbprint
from ca.revocation.trust_status import TrustStatus
from grants.decision import Decision
from grants.errors import GrantError, GrantForged, GrantMissing, GrantNotHeld, GrantRevoked
from grants.model import Right
from rossec.participant.access import Access
from tests.support.domains import Pair, SomeNode, domains, foreign, grant
from tests.support.pki import NOW, Site

HERE, ALIAS, THERE = "/robot/pose", "/remote/hospital/ward/pose", "/ward/pose"
DOMAIN = "hospital.example"
PUBLISH, SUBSCRIBE = Right.PUBLISH, Right.SUBSCRIBE


@pytest.fixture
def pair() -> Pair:
    pair = Pair()
    pair.confirm_own()
    pair.confirm_foreign()
    return pair


@pytest.fixture
def access(pair: Pair) -> Access:
    return Access(pair.trust_status)


def shown(*tokens: bytes) -> bytes:
    return encode(list[Value](tokens))


def decide(pair: Pair, access: Access, token: bytes, right: Right, name: str) -> Decision:
    return access.authorize(pair.peer(), shown(token), right, name, NOW)


def to_robot(pair: Pair, by: Site, right: Right, pattern: str, domain: str = "") -> bytes:
    return grant(by, pair.robot.identity.thumbprint, right, pattern, domain=domain)


def test_a_foreigner_uses_a_name_here_by_a_grant_of_the_home(pair: Pair, access: Access) -> None:
    token = to_robot(pair, pair.home, SUBSCRIBE, HERE)
    assert decide(pair, access, token, SUBSCRIBE, HERE).name == HERE


def test_a_foreign_authority_gives_nothing_here(pair: Pair, access: Access) -> None:
    of_theirs = to_robot(pair, pair.hospital, SUBSCRIBE, "/**")
    with pytest.raises(GrantError):
        decide(pair, access, of_theirs, SUBSCRIBE, HERE)
    for_ours = to_robot(pair, pair.hospital, SUBSCRIBE, HERE, domain="home")
    with pytest.raises(GrantForged):
        decide(pair, access, for_ours, SUBSCRIBE, HERE)


def test_a_name_there_is_proved_by_a_grant_of_that_domain(pair: Pair, access: Access) -> None:
    token = to_robot(pair, pair.hospital, PUBLISH, THERE)
    decision = decide(pair, access, token, PUBLISH, ALIAS)
    assert (decision.name, decision.grants[0].domain) == (ALIAS, DOMAIN)
    with pytest.raises(GrantError):
        decide(pair, access, token, PUBLISH, THERE)


@pytest.mark.parametrize("pattern", ["/**", "/ward/pose", "/remote/hospital/ward/pose"])
@pytest.mark.parametrize("domain", ["", DOMAIN])
def test_the_own_authority_gives_nothing_there(pair: Pair, access: Access, pattern: str, domain: str) -> None:
    token = to_robot(pair, pair.home, PUBLISH, pattern, domain)
    with pytest.raises(GrantError):
        decide(pair, access, token, PUBLISH, ALIAS)


def test_an_own_node_that_visits_there_is_known_by_a_grant_of_that_domain(pair: Pair, access: Access) -> None:
    guest = SomeNode(pair.home, "/guest")
    token = grant(pair.hospital, guest.identity.thumbprint, PUBLISH, THERE)
    assert access.authorize(guest.identity, shown(token), PUBLISH, ALIAS, NOW).name == ALIAS


def test_a_grant_of_another_key_is_not_the_peers(pair: Pair, access: Access) -> None:
    token = grant(pair.hospital, bytes(32), PUBLISH, THERE)
    with pytest.raises(GrantNotHeld):
        decide(pair, access, token, PUBLISH, ALIAS)


def test_what_is_shown_are_the_grants_of_the_domain_of_the_name(pair: Pair) -> None:
    key = bytes(32)
    own = grant(pair.home, key, SUBSCRIBE, "/**")
    theirs = grant(pair.hospital, key, SUBSCRIBE, THERE)
    access = Access(pair.trust_status, [own, theirs])
    assert access.present(SUBSCRIBE, ALIAS, NOW) == shown(theirs)
    assert access.present(SUBSCRIBE, THERE, NOW) == shown(own)
    assert access.present(SUBSCRIBE, "/remote/hospital/other", NOW) == shown()
    assert access.holds(SUBSCRIBE, ALIAS, NOW)
    assert not access.holds(PUBLISH, ALIAS, NOW)
    assert access.foreign_domains == {DOMAIN}


def test_an_alias_of_no_domain_is_no_name_for_messages(pair: Pair) -> None:
    access = Access(pair.trust_status, [grant(pair.home, bytes(32), Right(255), "/**")])
    name = "/remote/clinic/pose"
    with pytest.raises(NotAdmitted, match=r"clinic:/pose: no domain is called clinic here"):
        access.present(SUBSCRIBE, name, NOW)
    with pytest.raises(NotAdmitted):
        access.authorize(pair.own_master.identity, shown(), PUBLISH, name, NOW)
    with pytest.raises(NameRefused):
        access.present(SUBSCRIBE, "/remote/clinic", NOW)
    assert not access.holds(SUBSCRIBE, name, NOW)
    assert access.holds(Right.PARAM_GET, name, NOW), "of another master of the own domain"


def test_grants_of_a_domain_that_is_not_listed_are_kept_and_not_shown(pair: Pair) -> None:
    own, theirs = (grant(site, bytes(32), SUBSCRIBE, "/x") for site in (pair.home, pair.hospital))
    anchors = Anchors(pair.home.anchor)
    access = Access(TrustStatus(anchors, pair.own), [own, theirs])
    assert access.current(NOW) == [own]
    assert access.foreign_domains == frozenset()
    anchors.update(domains(pair.home, foreign(pair.hospital)))
    assert set(access.current(NOW)) == {own, theirs}


def test_a_grant_ends_by_the_list_of_the_domain_it_is_of(pair: Pair, access: Access) -> None:
    token = to_robot(pair, pair.hospital, PUBLISH, THERE)
    decision = decide(pair, access, token, PUBLISH, ALIAS)
    pair.confirm_foreign(decision.grants[0].id, seq=2)
    with pytest.raises(GrantRevoked):
        decide(pair, access, token, PUBLISH, ALIAS)
    ours = Access(pair.trust_status, [token])
    assert ours.held_grants() == []


def test_a_grant_of_the_home_ends_by_its_list_or_that_of_its_holder(pair: Pair, access: Access) -> None:
    token = to_robot(pair, pair.home, SUBSCRIBE, HERE)
    grant_id = decide(pair, access, token, SUBSCRIBE, HERE).grants[0].id
    pair.confirm_foreign(grant_id, seq=2)
    with pytest.raises(GrantRevoked):
        decide(pair, access, token, SUBSCRIBE, HERE)
    pair.confirm_foreign(seq=3)
    decide(pair, access, token, SUBSCRIBE, HERE)
    pair.confirm_own(grant_id, seq=2)
    with pytest.raises(GrantRevoked):
        decide(pair, access, token, SUBSCRIBE, HERE)


def test_a_hospital_revokes_no_grant_between_nodes_of_the_home(pair: Pair, access: Access) -> None:
    node = SomeNode(pair.home, "/viewer")
    token = grant(pair.home, node.identity.thumbprint, SUBSCRIBE, HERE)
    decision = access.authorize(node.identity, shown(token), SUBSCRIBE, HERE, NOW)
    pair.confirm_foreign(decision.grants[0].id, node.identity.thumbprint, seq=2)
    access.authorize(node.identity, shown(token), SUBSCRIBE, HERE, NOW)


def test_a_foreigner_is_refused_at_once_without_fresh_word_of_its_domain(pair: Pair) -> None:
    stale = Pair()
    stale.confirm_own()
    token = to_robot(stale, stale.home, SUBSCRIBE, HERE)
    with pytest.raises(RevocationsStale, match="of domain hospital"):
        decide(stale, Access(stale.trust_status), token, SUBSCRIBE, HERE)


def test_a_revoked_or_removed_foreigner_is_refused(pair: Pair, access: Access) -> None:
    token, peer = to_robot(pair, pair.home, SUBSCRIBE, HERE), pair.peer()
    pair.confirm_foreign(peer.thumbprint, seq=2)
    with pytest.raises(Revoked):
        access.authorize(peer, shown(token), SUBSCRIBE, HERE, NOW)
    pair.confirm_foreign(seq=3)
    pair.anchors.update(domains(pair.home, seq=2))
    with pytest.raises(NotAdmitted):
        access.authorize(peer, shown(token), SUBSCRIBE, HERE, NOW)


def test_a_foreigner_without_a_grant_is_told_the_command_of_the_home(pair: Pair, access: Access) -> None:
    with pytest.raises(GrantMissing, match=r"^hospital:/rounds/robot3 shows no grant") as caught:
        access.authorize(pair.peer(), None, SUBSCRIBE, HERE, NOW)
    assert "rossec grant sign hospital:/rounds/robot3 --subscribe /robot/pose" in (caught.value.hint)


def test_the_label_decides_which_key_opens_a_grant(pair: Pair, access: Access) -> None:
    token = to_robot(pair, pair.hospital, PUBLISH, THERE)
    decide(pair, access, token, PUBLISH, ALIAS)
    new = Site.create(DOMAIN)
    listed = foreign(new)
    pair.anchors.update(domains(pair.home, listed, seq=2))
    robot = SomeNode(new, "/rounds/robot3")
    object.__setattr__(robot.identity, "thumbprint", pair.robot.identity.thumbprint)
    with pytest.raises(GrantError):  # verified before, under the root that is gone
        access.authorize(robot.identity, shown(token), PUBLISH, ALIAS, NOW)


def test_the_own_master_is_known_by_its_name_and_domain(pair: Pair) -> None:
    kitchen = SomeNode(pair.home, "/master/kitchen").identity
    theirs = pair.peer(pair.master)
    assert Access(pair.trust_status).is_master(pair.own_master.identity)
    assert not Access(pair.trust_status).is_master(kitchen)
    assert not Access(pair.trust_status).is_master(theirs)
    assert not Access(pair.trust_status, master="/master/kitchen").is_master(pair.own_master.identity)
    assert Access(pair.trust_status, master="/master/kitchen").is_master(kitchen)
    assert not Access(pair.trust_status, master=theirs.name).is_master(theirs)


def test_a_clock_set_back_makes_foreign_words_stale_too(pair: Pair, access: Access) -> None:
    access.expire_confirmation(NOW - 1)
    with pytest.raises(RevocationsStale):
        access.check_peer(pair.peer(), NOW)
    assert pair.trust_status.status_valid_until(DOMAIN, thumbprint(pair.robot.key)) == NOW - 1


def test_a_label_is_that_of_a_listed_domain(access: Access) -> None:
    assert access.domain_called("hospital") == DOMAIN
    assert access.domain_called("clinic") is None
    assert access.master == "/master"

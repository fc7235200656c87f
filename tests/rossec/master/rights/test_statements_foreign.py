"""Grants of several domains, and callers of other domains, in one state of trust."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest

from ca.certificates import Identity
from ca.domains import Anchors
from ca.errors import CAError, Revoked
from ca.revocation.trust_status import TrustStatus
from grants.model import Right
from rossec.master.rights.domain_trust import DomainTrust
from rossec.master.rights.statements import TrustState
from rossec.master.state.registry import NodeRef
from tests.rossec.master.visiting import HOSPITAL, Hospital, Lists
from tests.support.authority import DAY, EnrolledNode, Site

POSE = "/remote/hospital/pose"
ROBOT = "/remote/hospital/rounds/robot3"


class Home:
    """A home that lists a hospital: `/node` of the one, `/rounds/robot3` of the other."""

    def __init__(self, **changes: Any) -> None:
        self.site, self.hospital = Site(), Hospital()
        self.now, self.lists = self.site.now, Lists(self.site)
        self.master, self.node = self.site.enroll("/master"), self.site.enroll("/node")
        self.robot = self.hospital.site.enroll("/rounds/robot3")
        own = self.site.revocations()
        domains = DomainTrust(TrustStatus(Anchors(self.site.anchor), own))
        self.trust = TrustState(
            self.site.anchor, self.master.credentials.signer, own, lambda _: None, domains=domains
        )
        self.trust.update(self.site.revoke(), self.now)
        self.trust.update_domains(self.lists.next(self.hospital.entry(**changes)))
        self.trust.domains.take(HOSPITAL, *self.hospital.word(), self.now)

    def identity(self, member: EnrolledNode) -> Identity:
        return self.trust.domains.anchors.verify(member.credentials.chain, self.now)

    def present(self, member: EnrolledNode, *tokens: bytes) -> tuple[int, tuple[str, ...]]:
        caller = self.trust.caller(self.identity(member), self.now)
        return self.trust.present(caller, tokens, self.now)

    def may(self, member: EnrolledNode, right: Right, name: str) -> bool:
        return self.trust.caller(self.identity(member), self.now).may(right, name)

    def from_hospital(self, member: EnrolledNode, name: str = "/pose") -> bytes:
        return self.hospital.site.grant(member, {name: Right.SUBSCRIBE})


@pytest.fixture
def home() -> Home:
    return Home()


def test_grants_of_two_domains_are_apart(home: Home) -> None:
    held = home.present(
        home.node, home.from_hospital(home.node), home.site.grant(home.node, {"/a": Right.PUBLISH})
    )
    assert held == (2, ())
    assert home.may(home.node, Right.SUBSCRIBE, POSE)
    assert home.may(home.node, Right.PUBLISH, "/a")
    assert not home.may(home.node, Right.SUBSCRIBE, "/pose")
    assert not home.may(home.node, Right.SUBSCRIBE, "/remote/hospital/a")


def test_a_grant_of_a_domain_that_is_not_listed_is_refused(home: Home) -> None:
    clinic = Hospital("clinic.example")
    held, [refused] = home.present(home.node, clinic.site.grant(home.node, {"/p": Right.CALL}))
    assert (held, "not a grant of this authority" in refused) == (0, True)


def test_a_grant_with_the_name_of_a_listed_domain_needs_its_key(home: Home) -> None:
    forger = Hospital(HOSPITAL)
    assert home.present(home.node, forger.site.grant(home.node, {"/p": Right.CALL}))[0] == 0
    home.hospital.site.domain = "home"  # signed by the hospital, for the home
    assert home.present(home.node, home.from_hospital(home.node))[0] == 0


def test_a_foreigner_presents_own_grants_alone(home: Home) -> None:
    assert home.present(home.robot, home.from_hospital(home.robot))[0] == 0
    assert home.present(home.robot, home.site.grant(home.robot, {"/pose": Right.SUBSCRIBE}))[0] == 1
    assert home.may(home.robot, Right.SUBSCRIBE, "/pose")
    assert not home.may(home.robot, Right.SUBSCRIBE, POSE)


def test_a_grant_of_another_key_is_refused(home: Home) -> None:
    held, [refused] = home.present(home.node, home.from_hospital(home.robot))
    assert (held, "bound to another key" in refused) == (0, True)


def test_an_export_bounds_a_foreigner() -> None:
    home = Home(exported=(("/pose", int(Right.SUBSCRIBE)),))
    home.present(home.robot, home.site.grant(home.robot, {"/**": Right(255)}))
    assert home.may(home.robot, Right.SUBSCRIBE, "/pose")
    assert not home.may(home.robot, Right.PUBLISH, "/pose")
    assert not home.may(home.robot, Right.SUBSCRIBE, "/lamp")


@pytest.mark.parametrize("by", ["own authority", "its authority"])
def test_a_revoked_foreigner_is_no_caller(home: Home, by: str) -> None:
    ref = NodeRef(ROBOT, "http://10.0.0.9:1/", home.robot.thumbprint)
    identity = home.identity(home.robot)
    assert home.trust.caller_of(ref, home.now) is None  # never seen
    home.trust.admit(identity, home.now)
    assert home.trust.caller_of(ref, home.now) is not None
    if by == "own authority":
        home.trust.update(home.site.revoke(home.robot), home.now)
    else:
        home.trust.domains.take(HOSPITAL, *home.hospital.word(home.robot), home.now)
    with pytest.raises(Revoked):
        home.trust.admit(identity, home.now)
    assert home.trust.caller_of(ref, home.now) is None


@pytest.mark.parametrize(
    "change",
    [
        lambda home: home.lists.next(),
        lambda home: home.lists.next(home.hospital.entry("clinic")),
        lambda home: home.lists.next(home.hospital.entry(admitted=("/kitchen/*",))),
        lambda home: home.lists.next(home.hospital.entry(until=home.now)),
        lambda home: home.lists.next(Hospital(HOSPITAL).entry()),
    ],
    ids=["gone", "label", "admitted", "until", "root"],
)
def test_other_terms_end_a_visit(home: Home, change: Callable[[Home], bytes]) -> None:
    identity = home.identity(home.robot)
    home.trust.caller(identity, home.now)
    assert home.trust.update_domains(change(home))
    with pytest.raises(CAError):
        home.trust.caller(identity, home.now)


def test_the_same_terms_end_nothing(home: Home) -> None:
    home.present(home.node, home.from_hospital(home.node))
    assert home.trust.update_domains(home.lists.next(home.hospital.entry(fresh=7200)))
    assert home.may(home.node, Right.SUBSCRIBE, POSE)


@pytest.mark.parametrize("root", ["the same", "another"])
def test_grants_of_a_domain_that_was_gone_are_presented_again(home: Home, root: str) -> None:
    home.present(home.node, home.from_hospital(home.node))
    home.trust.update_domains(home.lists.next())
    again = home.hospital if root == "the same" else Hospital(HOSPITAL)
    home.trust.update_domains(home.lists.next(again.entry()))
    assert not home.may(home.node, Right.SUBSCRIBE, POSE)
    expected = 1 if root == "the same" else 0
    assert home.present(home.node, home.from_hospital(home.node))[0] == expected


def test_a_grant_the_other_authority_revoked_ends_at_once(home: Home) -> None:
    grant = home.from_hospital(home.node)
    home.present(home.node, grant)
    home.trust.domains.take(HOSPITAL, *home.hospital.word(grant), home.now)
    assert not home.may(home.node, Right.SUBSCRIBE, POSE)


def test_the_other_authority_revokes_nothing_of_ours(home: Home) -> None:
    grant = home.site.grant(home.node, {"/a": Right.PUBLISH})
    home.present(home.node, grant)
    home.trust.domains.take(HOSPITAL, *home.hospital.word(grant, home.node), home.now)
    assert home.may(home.node, Right.PUBLISH, "/a")


def test_nothing_is_renewed_for_a_foreigner(home: Home) -> None:
    home.trust.update_delegation(home.site.delegation(home.master))
    caller = home.trust.caller(home.identity(home.robot), home.now)
    grant = home.site.grant(home.robot, {"/a": Right.PUBLISH}, lifetime=60, cap=DAY)
    tokens, [refused] = home.trust.renew(caller, [grant], home.now)
    assert tokens == (b"",)
    assert "another domain" in refused


def test_one_key_of_two_domains_is_two_callers(home: Home) -> None:
    twin = home.hospital.site.certify("/rounds/robot3", home.node.signer)
    home.present(home.node, home.site.grant(home.node, {"/a": Right.PUBLISH}))
    assert home.may(home.node, Right.PUBLISH, "/a")
    assert not home.may(twin, Right.PUBLISH, "/a")


@pytest.mark.parametrize("whose", ["own", "foreign"])
def test_a_twin_does_not_hide_a_revoked_intermediate(home: Home, whose: str) -> None:
    issuer = b"i" * 32
    twin = home.identity(home.hospital.site.certify("/rounds/robot3", home.node.signer))
    own = home.node.identity
    if whose == "own":
        own = replace(own, issuers=(issuer,))
    else:
        twin = replace(twin, issuers=(issuer,))
    revoked, other = (own, twin) if whose == "own" else (twin, own)
    for identity in (revoked, other):
        home.trust.admit(identity, home.now)
    registered = NodeRef(revoked.name, "http://10.0.0.9:1/", revoked.thumbprint)
    assert home.trust.caller_of(registered, home.now) is not None
    home.trust.update(home.site.revoke(issuer), home.now)
    home.trust.admit(other, home.now)
    assert home.trust.caller_of(registered, home.now) is None


@pytest.mark.parametrize("listed", [True, False])
def test_tickets_of_listed_masters_count(home: Home, listed: bool) -> None:
    other = home.site.enroll("/master/kitchen")
    trust = TrustState(home.site.anchor, other.credentials.signer, home.site.revocations(), lambda _: None)
    newest = home.site.revoke()
    for state in (trust, home.trust):
        state.update(newest, home.now)
    trust.update_delegation(home.site.delegation(other))
    grant = home.site.grant(home.node, {"/a": Right.PUBLISH}, lifetime=60, cap=DAY)
    [token], _ = trust.renew(trust.caller(home.node.identity, home.now), [grant], home.now)
    masters = (home.master, other) if listed else (home.master,)
    home.trust.update_domains(home.lists.next(home.hospital.entry(), masters=masters))
    held, refused = home.present(home.node, token)
    assert held == int(listed)
    assert bool(refused) != listed
    if listed:
        home.trust.update(home.site.revoke(other), home.now)
        assert not home.may(home.node, Right.PUBLISH, "/a")


def test_an_own_master_is_recognized(home: Home) -> None:
    kitchen = home.site.enroll("/master/kitchen")
    assert not home.trust.caller(kitchen.identity, home.now).is_own_master
    home.trust.update_domains(home.lists.next(masters=(home.master, kitchen)))
    assert home.trust.caller(kitchen.identity, home.now).is_own_master
    assert home.trust.caller(kitchen.identity, home.now).may_see("/a")


def test_foreigners_that_are_gone_are_forgotten(home: Home) -> None:
    home.present(home.robot, home.site.grant(home.robot, {"/pose": Right.SUBSCRIBE}))
    home.trust.keep_only(frozenset(), home.now)
    ref = NodeRef(ROBOT, "http://10.0.0.9:1/", home.robot.thumbprint)
    assert home.trust.caller_of(ref, home.now) is None
    assert not home.may(home.robot, Right.SUBSCRIBE, "/pose")

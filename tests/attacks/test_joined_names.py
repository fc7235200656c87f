"""Mallory has a code, and asks for a name that is or was of another node.

At the authority itself, and at an intermediate, whose record is not all.
"""

import copy
from pathlib import Path

import pytest

from ca.authority import Authority
from ca.certificates import build_intermediate_request, from_pem
from ca.enrollment.join import WaitingMessage, WaitReason
from ca.store.record import Store
from rossec.authority import invitations
from rossec.authority.renewals import sign_intermediate
from rossec.authority.signing import SigningAuthority
from tests.support.joining import JoinSite, asked, issued
from tests.support.pki import NOW, new_signer

PERSON = WaitingMessage(WaitReason.PERSON)


@pytest.fixture
def home(tmp_path: Path) -> JoinSite:
    return JoinSite(tmp_path / "site")


def below(home: JoinSite) -> JoinSite:
    """An intermediate of the site that may enroll, with a record of its own."""
    signer = new_signer()
    request = build_intermediate_request(signer, "home")
    _, bundle = sign_intermediate(home.authority, request, NOW, may_enroll=True)
    der, root = from_pem(bundle)
    place = home.site.root / "intermediate"
    place.mkdir()
    made = copy.copy(home)
    made.store = Store.create(place / "ca.db")
    made.authority = SigningAuthority(Authority(signer, root, der), made.store, place)
    return made


@pytest.mark.attack("join-name")
@pytest.mark.parametrize("name", ["/fleet/doctor", "/fleet/new"])
def test_an_invitation_of_an_intermediate_for_a_name_of_the_root(home: JoinSite, name: str) -> None:
    """Its record is not all: a person decides, who can ask the root."""
    issued(home.join(home.invite(), "/fleet/doctor"))
    host, mine = below(home), new_signer()
    code = host.invite(uses=2)
    csr = asked(name, mine)
    assert invitations.join(host.authority, host.request(code, csr), NOW) == PERSON
    assert host.store.identities.by_name(name) == []
    assert host.store.invitations.uses(code.id) == []
    host.authority.issue(csr, NOW)  # the person: nobody else has it
    assert issued(invitations.join(host.authority, host.request(code, csr), NOW))
    host.store.log.audit(host.authority.signer.public_key)


REVOKED = {
    "a tail over a revoked name": ("/fleet/cam_1", False, "/fleet/cam", True),
    "a name in a revoked tail": ("/fleet/cam", True, "/fleet/cam_1", False),
    "a longer tail": ("/fleet/cam", True, "/fleet/cam_1", True),
    "the tail itself": ("/fleet/cam", True, "/fleet/cam", False),
}


@pytest.mark.attack("join-name")
@pytest.mark.parametrize("expired", [True, False])
@pytest.mark.parametrize("case", REVOKED.values(), ids=REVOKED)
def test_an_invitation_for_a_name_that_ended_with_another_key(
    home: JoinSite, case: tuple[str, bool, str, bool], expired: bool
) -> None:
    old, old_tail, name, tail = case
    first = home.invite(old, lasts=90 * 86400, wildcard=old_tail)
    issued(home.join(first, old))
    now = NOW + 40 * 86400 if expired else NOW
    if not expired:
        home.authority.revoke_identity(old, "stolen", NOW)
    code = home.invite(name, lasts=90 * 86400, wildcard=tail)
    assert home.join(code, name, now=now) == PERSON
    assert home.store.invitations.uses(code.id) == []


@pytest.mark.attack("join-name")
def test_a_name_that_another_asks_for_through_a_tail(home: JoinSite) -> None:
    host = below(home)
    one, other = host.invite("/fleet/cam", wildcard=True), host.invite("/fleet/cam_1")
    assert host.join(one, "/fleet/cam") == host.join(other, "/fleet/cam_1") == PERSON

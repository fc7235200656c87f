"""Chains of narrowings presented to the master: each link counts, in one domain, of both lists."""

import secrets

import pytest

from grants.document import peek, sign
from grants.model import Draft, Permission, Right
from grants.token import pack_chain, sign_narrowing
from tests.rossec.master.rights.test_statements_foreign import Home
from tests.rossec.master.visiting import HOSPITAL, Hospital
from tests.support.authority import DAY, EnrolledNode, Site

ALL = Right.SUBSCRIBE | Right.PUBLISH


def narrowable(site: Site, to: EnrolledNode, subject: str) -> bytes:
    """A grant of `/**` that may be narrowed once; `subject` is what `site` calls the holder."""
    draft = Draft(
        site.domain,
        subject,
        to.thumbprint,
        site.now,
        site.now + DAY,
        site.now + DAY,
        secrets.token_bytes(16),
        (Permission("/**", ALL),),
        may_narrow=1,
    )
    return sign(site.signer, draft)


def narrowed(grant: bytes, by: EnrolledNode, to: EnrolledNode, subject: str) -> bytes:
    """The chain in which `by` hands on subscribing to `/pose`."""
    parent = peek(grant)
    draft = Draft(
        parent.domain,
        subject,
        to.thumbprint,
        parent.not_before,
        parent.expires,
        parent.expires,
        secrets.token_bytes(16),
        (Permission("/pose", Right.SUBSCRIBE),),
    )
    return pack_chain(grant, [sign_narrowing(by.signer, draft, parent)])


@pytest.fixture
def home() -> Home:
    return Home()


def test_what_a_foreigner_hands_on_in_its_domain_counts(home: Home) -> None:
    second = home.hospital.site.enroll("/rounds/robot7")
    grant = narrowable(home.site, home.robot, "/remote/hospital/rounds/robot3")
    chain = narrowed(grant, home.robot, second, "/remote/hospital/rounds/robot7")
    assert home.present(second, chain) == (1, ())
    assert home.may(second, Right.SUBSCRIBE, "/pose")
    assert not home.may(second, Right.PUBLISH, "/pose")
    assert not home.may(second, Right.SUBSCRIBE, "/lamp")


@pytest.mark.parametrize("what", ["the grant", "the first key", "the chain's key"])
@pytest.mark.parametrize("by", ["home", "hospital"])
def test_each_link_ends_it(home: Home, what: str, by: str) -> None:
    second = home.hospital.site.enroll("/rounds/robot7")
    grant = narrowable(home.site, home.robot, "/remote/hospital/rounds/robot3")
    chain = narrowed(grant, home.robot, second, "/remote/hospital/rounds/robot7")
    home.present(second, chain)
    entry = {
        "the grant": peek(grant).id,
        "the first key": home.robot.thumbprint,
        "the chain's key": second.thumbprint,
    }[what]
    caller = home.trust.caller(home.identity(second), home.now)
    if by == "home":
        home.trust.update(home.site.revoke(entry), home.now)
    else:
        home.trust.domains.take(HOSPITAL, *home.hospital.word(entry), home.now)
    assert caller.may(Right.SUBSCRIBE, "/pose")  # as it was
    if what == "the chain's key":
        with pytest.raises(Exception, match="revoked"):
            home.trust.caller(home.identity(second), home.now)
    else:
        assert not home.may(second, Right.SUBSCRIBE, "/pose")


@pytest.mark.parametrize("to", ["clinic", "home"])
def test_a_chain_that_leaves_its_domain_is_refused(home: Home, to: str) -> None:
    clinic = Hospital("clinic.example")
    listed = home.lists.next(home.hospital.entry(), clinic.entry("clinic"))
    home.trust.update_domains(listed)
    home.trust.domains.take("clinic.example", *clinic.word(), home.now)
    third = clinic.site.enroll("/rounds/robot3") if to == "clinic" else home.node
    grant = narrowable(home.site, home.robot, "/remote/hospital/rounds/robot3")
    chain = narrowed(grant, home.robot, third, "/remote/hospital/rounds/robot7")
    held, [refused] = home.present(third, chain)
    assert (held, "another domain" in refused) == (0, True)


def test_a_chain_of_own_nodes_is_not_handed_to_a_foreigner(home: Home) -> None:
    grant = narrowable(home.site, home.node, "/node")
    chain = narrowed(grant, home.node, home.robot, "/node2")
    held, [refused] = home.present(home.robot, chain)
    assert (held, "another domain" in refused) == (0, True)


def test_what_an_own_node_hands_on_of_a_foreign_grant_counts_there(home: Home) -> None:
    second = home.site.enroll("/second")
    grant = narrowable(home.hospital.site, home.node, "/remote/house/node")
    chain = narrowed(grant, home.node, second, "/remote/house/second")
    assert home.present(second, chain) == (1, ())
    assert home.may(second, Right.SUBSCRIBE, "/remote/hospital/pose")
    assert not home.may(second, Right.SUBSCRIBE, "/pose")
    home.trust.update(home.site.revoke(home.node), home.now)  # the key of the first link
    assert not home.may(second, Right.SUBSCRIBE, "/remote/hospital/pose")


def test_the_hospitals_own_chain_is_none_for_an_own_node(home: Home) -> None:
    grant = narrowable(home.hospital.site, home.robot, "/rounds/robot3")
    chain = narrowed(grant, home.robot, home.node, "/rounds/robot7")
    held, [refused] = home.present(home.node, chain)
    assert (held, "another domain" in refused) == (0, True)

import dataclasses
import io
import secrets

import pytest

from ca.revocation.lists import open_list
from grants import document
from grants.model import Draft, Permission, Right
from rossec import clock
from tests.rossec.cli.domain.sites import Neighbours
from tests.support.commands import PASSPHRASE, refused

GUEST = "/remote/hospital/rounds/robot3"


@pytest.fixture
def trusted(sites: Neighbours) -> Neighbours:
    sites.accept("--admit", "/rounds/*", "--export", "/a subscribe")
    return sites


def test_what_is_given_changes_and_the_rest_stays(trusted: Neighbours) -> None:
    (before,) = trusted.listed().domains
    said = trusted.change("limit", "hospital", "--fresh", "2h", "--import", "nothing", "--yes")
    assert "its word on its revocations may be 2h old" in said.out
    assert "changed (list of domains 2)" in said.out
    assert "did not take the list of domains" in said.err
    assert said.code == 3
    (after,) = trusted.listed().domains
    assert after == dataclasses.replace(before, fresh=7200, imported=())
    trusted.change("limit", "hospital", "--export", "everything", "--admit", "/a", "--yes")
    (last,) = trusted.listed().domains
    assert last.admitted == ("/a", "/master", "/master/*", "/relay", "/relay/*")
    assert (last.exported, last.imported, last.until) == (None, (), before.until)


def test_the_end_is_counted_from_now(trusted: Neighbours) -> None:
    trusted.change("limit", "hospital", "--for", "1h", "--yes")
    (entry,) = trusted.listed().domains
    assert 3590 < entry.until - clock.now() <= 3600


def test_a_change_that_is_none(trusted: Neighbours, monkeypatch: pytest.MonkeyPatch) -> None:
    refused(trusted.change("limit", "hospital", "--yes"), "nothing is changed", "--admit, --fresh")
    refused(trusted.change("limit", "ward", "--for", "1h"), "no domain is called 'ward'", "list")
    refused(trusted.change("limit", "hospital", "--export", "x", "--yes"), "not a pattern")
    monkeypatch.setattr("sys.stdin", io.StringIO("n\n"))
    said = trusted.change("limit", "hospital", "--for", "1h")
    assert (said.code, "nothing was done" in said.err) == (1, True)
    assert trusted.listed().seq == 1


def test_a_removed_domain_is_listed_no_more(trusted: Neighbours) -> None:
    said = trusted.change("remove", "hospital", "--reason", "the visit is over")
    assert said.out == "hospital.example is not trusted any more, nor called hospital\n"
    assert "rossec domain remove LABEL" in said.err
    refused(
        dataclasses.replace(said, err="\n".join(said.err.splitlines()[1:])),
        "did not take the list of domains",
        "rossec ca publish",
        code=3,
    )
    assert trusted.listed().domains == ()
    refused(trusted.change("remove", "hospital"), "no domain is called 'hospital'")
    assert trusted.shown()["reason"] == "the visit is over"


def give(sites: Neighbours) -> bytes:
    """Sign a grant for a node of the hospital; returns its id."""
    now, authority = clock.now(), sites.home.unlock(PASSPHRASE)
    draft = Draft(
        "home",
        GUEST,
        b"k" * 32,
        now,
        now + 900,
        now + 900,
        secrets.token_bytes(16),
        (Permission("/a", Right.SUBSCRIBE),),
    )
    data = authority.issue_grant(draft, now)
    authority.store.close()
    return document.grant_id(data)


def test_grants_for_its_nodes_are_pointed_out_or_revoked(trusted: Neighbours) -> None:
    given = give(trusted)
    assert trusted.shown()["grants"] == 1
    said = trusted.change("remove", "hospital")
    assert "1 grants for its nodes would hold again if it is accepted as hospital" in said.err
    trusted.accept()
    said = trusted.change("remove", "hospital", "--revoke-grants")
    assert "revoked 1 grants for its nodes" in said.out
    assert given in open_list(trusted.home.revocation_list(), trusted.home.own_key()).entries
    assert trusted.shown()["grants"] == 0

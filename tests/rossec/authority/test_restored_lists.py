from pathlib import Path

import pytest

from ca.errors import CAError, DomainsRefused, RevocationRefused
from ca.revocation.trust_status import Revocations
from rossec.authority import restored_lists
from rossec.authority.restored_lists import NewerLists
from rossec.authority.signing import SigningAuthority
from rossec.home import NodeHome
from tests.support.domains import domains, foreign
from tests.support.pki import NOW, Site
from tests.support.site import Site as WholeSite

ONE, TWO = b"1" * 32, b"2" * 32


@pytest.fixture
def authority(tmp_path: Path) -> SigningAuthority:
    return WholeSite(tmp_path / "site", clock=lambda: NOW).authority


def listed(authority: SigningAuthority) -> bytes:
    data = authority.store.newest_list()
    assert data is not None
    return data


def test_a_list_says_what_is_revoked_and_its_epoch(authority: SigningAuthority) -> None:
    anchor = authority.authority.anchor
    authority.revoke(ONE, "", NOW)
    assert restored_lists.read_revoked(listed(authority), None, anchor) == (frozenset({ONE}), 1)
    assert restored_lists.read_revoked(None, None, anchor) == (frozenset(), 0)
    with pytest.raises(RevocationRefused):
        restored_lists.read_revoked(b"rubbish", None, anchor)


def test_a_tree_needs_its_entries_and_they_are_found_beside_it(
    authority: SigningAuthority, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("rossec.authority.signing.MAX_ENTRIES", 0)
    authority.revoke(ONE, "", NOW)
    file, anchor = tmp_path / "revocations.cose", authority.authority.anchor
    file.write_bytes(listed(authority))
    with pytest.raises(CAError, match="a tree, which does not contain"):
        restored_lists.read_revoked(*restored_lists.read_files(file, None), anchor)
    file.with_name("revocations.entries").write_bytes(b"rubbish")
    with pytest.raises(RevocationRefused):
        restored_lists.read_revoked(*restored_lists.read_files(file, None), anchor)


def test_a_later_list_is_taken_over_at_any_time(authority: SigningAuthority) -> None:
    """By nodes that know the later one: the new list is newer for them."""
    anchor = authority.authority.anchor
    authority.revoke(ONE, "", NOW)
    authority.sign_list(NOW, new_epoch=True, above=NOW + 1000)  # the clock was ahead
    seen = listed(authority)
    node = Revocations(anchor.public_key)
    node.update(seen, NOW)
    authority.revoke(TWO, "", NOW)
    made, count = restored_lists.take_over(authority, seen, None, NOW)
    assert count == 0
    assert made.entries == {ONE, TWO}
    node.update(listed(authority), NOW)
    assert node.entries == {ONE, TWO}


def test_a_new_epoch_is_above_all_that_is_known(authority: SigningAuthority) -> None:
    newer = NewerLists(frozenset({ONE}), (), NOW + 500, NOW + 700)
    assert restored_lists.start_new_epoch(authority, newer, NOW) == 1
    found, epoch = restored_lists.read_revoked(listed(authority), None, authority.authority.anchor)
    assert found == {ONE}
    assert epoch == NOW + 501


def test_a_list_from_before_the_backup_is_none(authority: SigningAuthority) -> None:
    older = listed(authority)
    authority.revoke(ONE, "", NOW)
    same = listed(authority)
    with pytest.raises(CAError, match="older than the backup"):
        restored_lists.read_newer(authority, older, None, None)
    assert restored_lists.read_newer(authority, same, None, None).revoked == {ONE}
    assert restored_lists.read_newer(authority, None, None, None) == NewerLists()


def test_the_newest_list_here_is_named(
    authority: SigningAuthority, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    home, anchor = tmp_path / "a home", authority.authority.anchor
    places = [NodeHome.of(home, name) for name in ("/a", "/b", "/c", "/tree")]
    assert restored_lists.newest_here(home, anchor) is None
    with pytest.raises(CAError, match="valid again") as caught:
        restored_lists.require_list(authority, home, NOW)
    assert "scp 'HOST:ROSSEC_HOME/nodes/master/revocations.*' ." in caught.value.hint
    assert "--list revocations.cose; only if none is left: --without-list" in caught.value.hint
    for place, data in ((places[0], listed(authority)), (places[2], b"rubbish")):
        place.path.mkdir(parents=True)
        (place.path / "revocations.cose").write_bytes(data)
    authority.revoke(ONE, "", NOW)
    places[1].path.mkdir()
    newest = places[1].path / "revocations.cose"
    newest.write_bytes(listed(authority))
    assert restored_lists.newest_here(home, anchor) == newest
    with pytest.raises(CAError, match="would be valid again") as caught:
        restored_lists.require_list(authority, home, NOW)
    assert f"the newest here: --list '{newest}'" in caught.value.hint
    monkeypatch.setattr("rossec.authority.signing.MAX_ENTRIES", 0)
    authority.revoke(TWO, "", NOW)
    tree = places[3].path
    tree.mkdir()
    (tree / "revocations.cose").write_bytes(listed(authority))
    assert restored_lists.newest_here(home, anchor) == newest, "its entries are not there"
    (tree / "revocations.entries").write_bytes(b"")
    assert restored_lists.newest_here(home, anchor) == tree / "revocations.cose"


def test_a_master_of_the_record_is_where_the_newest_is(authority: SigningAuthority, tmp_path: Path) -> None:
    node = NodeHome.of(tmp_path / "other", "/master/beta")
    node.create_request(authority.domain)
    authority.issue(node.request(), NOW, 60)
    with pytest.raises(CAError, match="would be valid again") as caught:
        restored_lists.require_list(authority, tmp_path, NOW)
    assert "HOST:ROSSEC_HOME/nodes/master.beta/revocations.*" in caught.value.hint


def test_domains_are_those_of_the_list(authority: SigningAuthority) -> None:
    cafe = foreign(Site.create("cafe"), "cafe")
    authority.store.domains.accept(cafe, NOW)
    assert restored_lists.read_domains(None, authority) == ((), 0)
    signed = authority.sign_domains(NOW)
    data = authority.store.domains.newest_list()
    assert restored_lists.read_domains(data, authority) == ((cafe,), signed.epoch)
    assert restored_lists.end_domains(authority, (cafe,), NOW) == 0
    assert restored_lists.end_domains(authority, (), NOW) == 1
    assert authority.store.domains.accepted() == []
    assert restored_lists.end_domains(authority, (cafe,), NOW) == 0
    assert [row.read() for row in authority.store.domains.accepted()] == [cafe]
    authority.sign_domains(NOW)
    with pytest.raises(DomainsRefused, match="older than the backup"):
        restored_lists.read_domains(data, authority)
    with pytest.raises(DomainsRefused, match="not a list of domains"):
        restored_lists.read_domains(domains(Site.create("home")), authority)

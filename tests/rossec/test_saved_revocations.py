"""The list a node saved is where it begins again."""

from pathlib import Path

import pytest

from ca.errors import RevocationRefused
from rossec import clock
from rossec.saved_statements import saved_revocations
from tests.support.site import Site


def test_a_node_begins_with_what_it_saved(tmp_path: Path) -> None:
    site = Site(tmp_path / "site")
    home = site.enroll("/robot")
    assert saved_revocations(home, home.anchor(), clock.now()).data == b""
    newest = site.authority.store.newest_list()
    assert newest is not None
    home.save_revocations(newest)
    assert saved_revocations(home, home.anchor(), clock.now()).data == newest


def test_a_list_of_another_authority_is_refused(tmp_path: Path) -> None:
    home, other = Site(tmp_path / "site").enroll("/robot"), Site(tmp_path / "other")
    newest = other.authority.store.newest_list()
    assert newest is not None
    home.save_revocations(newest)
    with pytest.raises(RevocationRefused):
        saved_revocations(home, home.anchor(), clock.now())

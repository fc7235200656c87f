"""Which domains are trusted after a restore: those of a newer list, and else none."""

import dataclasses
from contextlib import closing
from pathlib import Path

import pytest

from ca.domains import Anchors, DomainList, ForeignDomain
from ca.errors import DomainsRefused
from rossec.authority.backup import Restored, back_up, restore
from rossec.authority.home import AuthorityHome
from rossec.authority.service import AuthorityService
from tests.support.commands import PASSPHRASE, Shell
from tests.support.domains import domains, foreign
from tests.support.pki import NOW, Site


class Trusting:
    """An authority that trusts two domains, and its backup."""

    def __init__(self, root: Path) -> None:
        self.home = AuthorityHome.create(root / "old", "home", PASSPHRASE, NOW)
        self.service = AuthorityService(root / "old", lambda: PASSPHRASE, print, lambda: NOW)
        self.hospital = foreign(Site.create("hospital.example"))
        self.cafe = foreign(Site.create("cafe"), "cafe")
        self.place = root / "new"
        for each in (self.hospital, self.cafe):
            self.service.domains.accept(each)
        self.backup = back_up(self.home, PASSPHRASE)

    def list(self) -> bytes:
        found = self.home.domain_list()
        assert found is not None
        return found[0]

    def restore(self, newest: bytes | None) -> Restored:
        return restore(self.place, self.backup, PASSPHRASE, NOW + 9, newest_domains=newest)


def content(home: AuthorityHome) -> tuple[DomainList, list[ForeignDomain]]:
    """The newest list, and what the record trusts."""
    found = home.domain_list()
    assert found is not None
    with closing(home.store()) as store:
        store.log.audit(home.own_key())
        return found[1], [row.read() for row in store.domains.accepted()]


@pytest.fixture
def trusting(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Trusting:
    monkeypatch.setattr("ca.keys.passphrases._N", 16)  # the passphrase is not under test
    return Trusting(tmp_path)


def test_without_a_newer_list_no_domain_is_trusted(trusting: Trusting) -> None:
    anchors = Anchors(trusting.home.anchor())
    anchors.update(trusting.list())
    done = trusting.restore(None)
    assert done.ended_domains == 2
    listed, held = content(done.home)
    assert (listed.number, listed.domains, held) == ((NOW + 9, 1), (), [])
    data, _ = done.home.domain_list() or (b"", None)
    assert anchors.update(data) == {"hospital.example", "cafe"}


def test_a_newer_list_says_what_was_done_since(trusting: Trusting) -> None:
    trusting.service.domains.remove("hospital", "", revoke_grants=False)
    office = foreign(Site.create("office"), "hospital")  # its label was free
    narrower = dataclasses.replace(trusting.cafe, admitted=("/a",))
    trusting.service.domains.accept(office)
    trusting.service.domains.accept(narrower)
    done = trusting.restore(trusting.list())
    assert done.ended_domains == 1
    listed, held = content(done.home)
    assert listed.domains == (narrower, office)
    assert held == [narrower, office]


def test_the_same_list_changes_nothing(trusting: Trusting) -> None:
    done = trusting.restore(trusting.list())
    assert done.ended_domains == 0
    assert content(done.home)[1] == [trusting.cafe, trusting.hospital]


def test_an_older_or_foreign_list_is_refused(trusting: Trusting) -> None:
    old = trusting.list()
    trusting.service.domains.remove("cafe", "", revoke_grants=False)
    trusting.backup = back_up(trusting.home, PASSPHRASE)
    with pytest.raises(DomainsRefused, match="older than the backup"):
        trusting.restore(old)
    with pytest.raises(DomainsRefused, match="not a list of domains of this authority"):
        trusting.restore(domains(Site.create("home")))
    assert not (trusting.place / "ca").exists()


def test_a_record_that_never_had_domains_signs_no_list(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("ca.keys.passphrases._N", 16)
    home = AuthorityHome.create(tmp_path / "home", "home", PASSPHRASE, NOW)
    done = restore(tmp_path / "new", back_up(home, PASSPHRASE), PASSPHRASE, NOW)
    assert (done.ended_domains, done.home.domain_list()) == (0, None)


def test_the_command_says_what_is_trusted_no_more(empty: Shell, trusting: Trusting, tmp_path: Path) -> None:
    file, newest = tmp_path / "b", tmp_path / "domains.cose"
    file.write_bytes(trusting.backup)
    newest.write_bytes(trusting.list())
    said = empty.unlocked("ca", "restore", str(file), "--without-list")
    assert "2 domains are trusted no more: see rossec domain list --all" in said.err
    assert len(empty("domain", "list", "--all").out.splitlines()) == 2
    again = ("ca", "restore", str(file), "--without-list", "--over", "home", "--domains", str(newest))
    lost = len(empty("ca", "log").out.splitlines()) - trusting_entries(trusting)
    said = empty.unlocked(*again, "--forget", str(lost))
    assert said.code == 0, said
    assert "trusted no more" not in said.err
    assert len(empty("domain", "list").out.splitlines()) == 2


def trusting_entries(trusting: Trusting) -> int:
    with closing(trusting.home.store()) as store:
        return len(store.log.entries())

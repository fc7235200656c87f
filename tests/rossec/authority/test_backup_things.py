"""Things after a restore: as the backup has them, and what a newer list revokes is revoked."""

from contextlib import closing
from pathlib import Path

import pytest

from rossec.authority.backup import back_up, restore
from rossec.authority.service import AuthorityService
from rossec.authority.signing import IN_FORCE, REVOKED
from tests.support.thingoffice import DAY, LAMP, PASSPHRASE, Office


@pytest.fixture
def office(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Office:
    monkeypatch.setattr("ca.keys.passphrases._N", 16)  # the passphrase is not under test
    return Office(tmp_path / "old")


@pytest.mark.parametrize(("with_list", "state"), [(True, REVOKED), (False, IN_FORCE)])
def test_what_was_revoked_since(office: Office, tmp_path: Path, with_list: bool, state: str) -> None:
    office.sign()
    backup = back_up(office.home, PASSPHRASE)
    listed, _ = office.service.things.revoke(LAMP, "lost")
    newest = office.home.revocation_list() if with_list else None
    done = restore(tmp_path / "new", backup, PASSPHRASE, office.now + 9, newest_list=newest)
    assert done.restored_revocations == (1 if with_list else 0)
    restored = AuthorityService(tmp_path / "new", lambda: PASSPHRASE, lambda _: None, lambda: office.now + 9)
    assert [each.state for each in restored.things.states()] == [state]
    restored.things.renew(LAMP, DAY) if not with_list else restored.things.sign(office.order)
    with closing(restored.home.store()) as store:
        store.log.audit(restored.home.own_key())
        assert len(store.things.all()) == 2
    assert listed.entries
    restored.close()

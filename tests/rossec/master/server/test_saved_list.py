"""A list is in force although the disk is full, and is saved later."""

from pathlib import Path

import pytest

from ca.revocation.lists import open_list
from rossec.master.server.saved_state import ListFile
from rossec.ros.names import MASTER
from tests.rossec.test_files import no_room
from tests.support.site import Site


def test_a_list_that_cannot_be_saved_is_saved_later(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    site = Site(tmp_path / "site")
    home = site.enroll(MASTER)
    file, first, second = ListFile(home), site.revoke(b"1" * 32), site.revoke(b"2" * 32)
    with no_room():
        file.save_entries(b"entries")
        file.save(first)
        file.save(second)
        file.retry()
    assert home.load_revocations() is home.load_entries() is None
    assert len(caplog.messages) == 1
    assert "a list is in force, but not saved: revocations.ent" in caplog.text
    assert "make room" in caplog.text
    file.retry()
    assert home.load_revocations() == second
    assert home.load_entries() == b"entries"
    assert caplog.messages[1:] == ["the newest lists are saved now"]
    file.retry()
    assert len(caplog.messages) == 2


def test_a_list_is_saved_at_once(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    site = Site(tmp_path / "site")
    home, data = site.enroll(MASTER), site.revoke(b"1" * 32)
    ListFile(home).save(data)
    assert home.load_revocations() == data
    assert open_list(data, site.anchor.public_key).entries == {b"1" * 32}
    assert caplog.text == ""

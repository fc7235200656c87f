"""The journal file of deposited grants."""

import os
import stat
from pathlib import Path

import pytest

from grants import document
from grants.model import Right
from rossec import files
from rossec.errors import NotWritten
from rossec.master.rights.held_grants import DeliveryState, verifier
from rossec.master.server import saved_state as module
from rossec.master.server.saved_state import DepositFile
from rossec.master.state.journals import (
    DEPOSITS_MAGIC,
    GrantDeposited,
    GrantHeld,
    decode_deposits,
    encode_deposit,
)
from tests.rossec.test_files import no_room
from tests.support.authority import Site

SITE = Site()
ROBOT = SITE.enroll("/robot")


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "deposits.journal"


def opened(path: Path) -> DepositFile:
    file = DepositFile(path, verifier(SITE.anchor, lambda _entry, _now: None))
    file.open()
    return file


def grant() -> bytes:
    return SITE.grant(ROBOT, {"/p": Right.PUBLISH})


def deposit(file: DepositFile, *grants: bytes) -> None:
    verified = [(data, file.deposits.verify(data, SITE.now)) for data in grants]
    assert file.deposits.add(verified) == [""] * len(grants)


def stored(path: Path) -> list[bytes]:
    changes, _ = decode_deposits(path.read_bytes())
    return [change.data for change in changes if isinstance(change, GrantDeposited)]


def test_a_deposit_is_synced_before_it_is_in_the_table(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file, one, two = opened(path), grant(), grant()
    synced: list[list[bytes]] = []
    with monkeypatch.context() as watched:
        watched.setattr(os, "fdatasync", lambda _: synced.append(stored(path)))
        deposit(file, one, two)
    assert synced == [[one, two]], "one sync for a batch, when everything is written"
    again = opened(path)  # as after kill -9
    assert again.deposits.changes() == [GrantDeposited(one), GrantDeposited(two)]
    assert stat.S_IMODE(path.stat().st_mode) == 0o600
    file.close()
    again.close()
    with pytest.raises(NotWritten, match="is not open"):
        deposit(file, grant())


def test_a_truncated_record_is_removed_and_saved_aside(path: Path, caplog: pytest.LogCaptureFixture) -> None:
    file, one, two = opened(path), grant(), grant()
    deposit(file, one)
    file.close()
    whole = path.read_bytes()
    path.write_bytes(whole + whole[len(DEPOSITS_MAGIC) : -3])
    deposit(opened(path), two)
    assert stored(path) == [one, two]
    assert "are damaged" in caplog.text
    assert path.with_suffix(".damaged").read_bytes().startswith(whole)


def test_what_was_presented_is_written_at_leisure(path: Path) -> None:
    file, one = opened(path), grant()
    deposit(file, one)
    before = path.read_bytes()
    file.sync()
    file.deposits.presented(ROBOT.thumbprint, [one])
    assert path.read_bytes() == before
    file.sync()
    file.sync()
    assert path.read_bytes() == before + encode_deposit(GrantHeld(document.grant_id(one)))
    assert opened(path).deposits.state(document.grant_id(one)) is DeliveryState.HELD


def test_the_file_is_compacted_when_it_has_grown(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "REWRITE_MIN", 1000)
    file, grants = opened(path), [grant() for _ in range(10)]
    deposit(file, *grants)
    gone = frozenset(map(document.grant_id, grants[1:]))
    file.deposits.drop_ended(SITE.now, gone)
    assert stored(path) == grants
    file.sync()
    assert stored(path) == grants[:1]
    deposit(file, grants[1])
    assert stored(opened(path)._journal.path) == grants[:2]


def test_a_full_disk_refuses_a_deposit_and_leaves_no_half_record(
    path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    file, one, two = opened(path), grant(), grant()
    deposit(file, one)
    before, write = path.read_bytes(), os.write
    with monkeypatch.context() as patch:
        patch.setattr(os, "write", lambda fd, data: write(fd, data[:5]))
        with pytest.raises(NotWritten, match="the disk is full"):
            deposit(file, two)
    assert path.read_bytes() == before
    with no_room():
        with pytest.raises(NotWritten, match=r"deposits\.journal was not written"):
            deposit(file, two)
        file.deposits.presented(ROBOT.thumbprint, [one])
        file.sync()
    assert "is not up to date" in caplog.text
    assert path.read_bytes() == before
    assert len(file.deposits) == 1
    deposit(file, two)
    file.sync()
    assert opened(path).deposits.changes() == [
        GrantDeposited(one),
        GrantDeposited(two),
        GrantHeld(document.grant_id(one)),
    ]


def test_a_file_that_cannot_be_opened_again_takes_no_deposit(
    path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Without a descriptor, what is appended would go to the file that was replaced."""
    monkeypatch.setattr(module, "REWRITE_MIN", 0)
    monkeypatch.setattr(module, "REWRITE_FACTOR", 1)
    file, one, two = opened(path), grant(), grant()
    deposit(file, one)
    replace = files.replace

    def replace_and_run_out(where: Path, data: bytes) -> None:
        replace(where, data)
        monkeypatch.setattr(os, "open", no_descriptor)

    def no_descriptor(*_: object) -> int:
        raise OSError(24, "Too many open files")

    with monkeypatch.context() as patch:
        patch.setattr(files, "replace", replace_and_run_out)
        file.sync()
    monkeypatch.undo()
    with pytest.raises(NotWritten, match="is not open"):
        deposit(file, two)
    assert stored(path) == [one]

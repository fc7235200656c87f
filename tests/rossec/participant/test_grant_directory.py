"""The grants in a node's directory: each is loaded once, useless files go."""

from pathlib import Path

import pytest

from grants import document
from grants.model import Right
from rossec.errors import NotWritten
from rossec.participant.access import Access
from rossec.participant.master_updates import KEPT, GrantDirectory
from rossec.participant.membership import LoadedIdentity
from tests.support.site import DAY, Site


class Robot:
    def __init__(self, root: Path) -> None:
        self.site = Site(root / "site")
        self.home = self.site.enroll("/robot")
        loaded = LoadedIdentity(self.home, "/robot")
        self.access = Access(loaded.trust_status)
        self.directory = GrantDirectory(self.home, self.access)

    def held(self) -> list[bytes]:
        return [each.token for each in self.access.held_grants()]

    def delivered(self) -> tuple[bytes, bytes]:
        """A grant that is not in the directory, and its id."""
        data = self.site.publish("/robot", "/p")
        grant_id = document.grant_id(data)
        self.home.grant_file(grant_id).unlink()
        return grant_id, data


@pytest.fixture
def robot(tmp_path: Path) -> Robot:
    return Robot(tmp_path)


def test_a_file_is_taken_once(robot: Robot, caplog: pytest.LogCaptureFixture) -> None:
    data = robot.site.publish("/robot", "/p")
    broken = robot.home.path / "grants" / "broken.grant"
    broken.write_bytes(b"noise")
    assert robot.directory.take_new() == [data]
    assert robot.directory.take_new() == []
    assert robot.held() == [data]
    assert caplog.text.count("is not a valid grant and is ignored") == 1
    broken.chmod(0o666)
    robot.directory.take_new()
    robot.directory.take_new()
    assert caplog.text.count("cannot be read") == 1


def test_a_delivered_grant_is_stored_and_held(robot: Robot) -> None:
    grant_id, data = robot.delivered()
    assert robot.directory.hold(data)
    robot.directory.save(grant_id, data)
    assert robot.home.grant_file(grant_id).read_bytes() == data
    assert robot.held() == [data]
    assert not robot.directory.hold(data), "not new"
    assert robot.directory.take_new() == [], "nor as a file"


def test_a_delivered_grant_is_used_even_if_the_disk_is_full(
    robot: Robot, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    grant_id, data = robot.delivered()

    def full(*_: object) -> None:
        raise NotWritten("the disk is full")

    with monkeypatch.context() as patch:
        patch.setattr("rossec.files.replace", full)
        assert robot.directory.hold(data)
        robot.directory.save(grant_id, data)
    assert robot.held() == [data]
    assert "is used, but not saved: the disk is full" in caplog.text


def test_files_of_grants_that_ended_long_ago_are_deleted(robot: Robot) -> None:
    now = robot.site.now()
    data = robot.site.grant("/robot", Right.PUBLISH, "/p", lifetime=DAY, cap=2 * DAY)
    path = robot.home.grant_file(document.grant_id(data))
    renamed, noise = path.with_name("mine.grant"), path.with_name(f"{'0' * 32}.grant")
    renamed.write_bytes(data)
    noise.write_bytes(b"noise")
    for file in (renamed, noise):
        file.chmod(0o600)
    robot.directory.drop_ended(now + 2 * DAY + KEPT - 2)
    assert path.exists()
    robot.directory.drop_ended(now + 2 * DAY + KEPT + 2)
    assert not path.exists()
    assert renamed.exists(), "somebody put it there"
    assert noise.exists(), "what it is is not known"

import logging
from pathlib import Path

import pytest

from rossec.participant.grant_directory import GrantDirectory
from tests.rossec.sidecar.agent_setup import AgentSetup
from tests.support.site import Site


@pytest.fixture
def site(tmp_path: Path) -> Site:
    return Site(tmp_path / "site")


@pytest.fixture
def directory(site: Site) -> GrantDirectory:
    setup = AgentSetup(site)
    return GrantDirectory(site.enroll("/robot"), setup.agent.access)


def test_each_grant_is_taken_once(site: Site, directory: GrantDirectory) -> None:
    assert directory.take_new() == []
    first = site.publish("/robot", "/a")
    assert directory.take_new() == [first]
    second = site.publish("/robot", "/b")
    assert directory.take_new() == [second]
    assert directory.take_new() == []


def test_an_invalid_grant_is_logged_once(
    site: Site, directory: GrantDirectory, caplog: pytest.LogCaptureFixture
) -> None:
    site.enroll("/robot").add_grant(bytes(16), b"no grant")
    for _ in range(3):
        assert directory.take_new() == []
    (line,) = caplog.messages
    assert "is not a valid grant and is ignored" in line


def test_a_file_that_cannot_be_read_is_logged_once_and_taken_when_it_can(
    site: Site, directory: GrantDirectory, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.WARNING)
    data = site.publish("/robot", "/a")
    (path,) = site.enroll("/robot").grant_files()
    path.chmod(0o666)
    for _ in range(3):
        assert directory.take_new() == []
    assert len(caplog.messages) == 1
    assert "cannot be read" in caplog.messages[0]
    path.chmod(0o600)
    assert directory.take_new() == [data]
    path.unlink()
    assert directory.take_new() == []

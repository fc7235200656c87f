"""Homes that commands work in, and a site with a running master."""

import shutil
import time
from collections.abc import AsyncIterator
from pathlib import Path

import pytest

from rossec.authority.home import AuthorityHome
from tests.support.commands import PASSPHRASE, Shell
from tests.support.discovered import Searches
from tests.support.site import Site


@pytest.fixture(scope="session")
def authority(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An authority made once (its key costs a second) and copied for every test."""
    home = tmp_path_factory.mktemp("authority") / "home"
    return AuthorityHome.create(home, "home", PASSPHRASE, int(time.time())).path


@pytest.fixture
def empty(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> Shell:
    """A home with nothing in it."""
    return Shell(tmp_path / "home", capsys)


@pytest.fixture
def shell(empty: Shell, authority: Path) -> Shell:
    """A home with an authority."""
    shutil.copytree(authority, empty.root / "ca")
    return empty


@pytest.fixture
async def site(tmp_path: Path) -> AsyncIterator[Site]:
    """A site whose master runs."""
    async with Site(tmp_path / "site").running() as site:
        yield site


@pytest.fixture
def searches(monkeypatch: pytest.MonkeyPatch) -> Searches:
    """Masters are found at once, where nothing listens."""
    found = Searches()
    monkeypatch.setattr("rossec.discovery.discover_master", found.discover)
    return found

import shutil
import time
from pathlib import Path

import pytest

from rossec.authority import AuthorityHome
from tests.support.commands import PASSPHRASE, Shell


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

"""A home and a hospital."""

from pathlib import Path

import pytest

from tests.rossec.cli.domain.sites import Neighbours
from tests.support.commands import Shell


@pytest.fixture
def sites(
    empty: Shell, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> Neighbours:
    """Two authorities; the hospital's bundle is made."""
    monkeypatch.setattr("ca.keys.passphrases._N", 16)  # the passphrase is not under test
    assert empty.unlocked("ca", "init", "home").code == 0
    return Neighbours(empty, tmp_path, capsys)

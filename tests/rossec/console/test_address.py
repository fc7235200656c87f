"""Where the console is, for the commands that show codes."""

from pathlib import Path

import pytest

from rossec.console.address import NAME, read_address, remove_address, write_address
from rossec.errors import ConfigurationError


def test_it_is_written_read_and_removed(tmp_path: Path) -> None:
    for origin in ("http://localhost:7411", "https://rossec.local:7411"):
        write_address(tmp_path, origin)
        assert read_address(tmp_path) == origin
    assert (tmp_path / NAME).stat().st_mode & 0o777 == 0o600
    remove_address(tmp_path)
    remove_address(tmp_path)
    with pytest.raises(ConfigurationError, match="no console runs"):
        read_address(tmp_path)

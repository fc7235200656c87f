"""Where the console is, for the commands that show codes."""

from pathlib import Path

import pytest

from rossec.console.listening import NAME, only_console, read_address, write_address
from rossec.errors import ConfigurationError


def test_it_is_written_read_and_removed(tmp_path: Path) -> None:
    for origin in ("http://localhost:7411", "https://rossec.local:7411"):
        write_address(tmp_path, origin)
        assert read_address(tmp_path) == origin
    assert (tmp_path / NAME).stat().st_mode & 0o777 == 0o600
    with only_console(tmp_path):
        assert read_address(tmp_path) == origin  # of one that was killed
    with pytest.raises(ConfigurationError, match="no console runs"):
        read_address(tmp_path)


def test_a_second_console_leaves_the_address_of_the_first_alone(tmp_path: Path) -> None:
    with only_console(tmp_path):
        write_address(tmp_path, "http://localhost:7411")
        with pytest.raises(ConfigurationError, match="another console") as caught, only_console(tmp_path):
            raise AssertionError
        assert "--read-only" in str(caught.value.hint)
        assert read_address(tmp_path) == "http://localhost:7411"
    with only_console(tmp_path), pytest.raises(ConfigurationError, match="no console runs"):
        read_address(tmp_path)

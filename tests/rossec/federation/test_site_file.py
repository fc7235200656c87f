from pathlib import Path

import pytest

from rossec.errors import ConfigurationError
from rossec.federation.settings import FILE, SiteFile, SiteSettings

KITCHEN = SiteSettings("kitchen", "http://kitchen:11311/", "/master/kitchen")


def add(sites: dict[str, SiteSettings]) -> None:
    sites["kitchen"] = KITCHEN


def test_a_running_master_reads_what_a_command_has_written(tmp_path: Path) -> None:
    running, command = SiteFile(tmp_path), SiteFile(tmp_path)
    assert running.sites() == ()
    command.change(add)
    assert running.sites() == (KITCHEN,)
    assert (tmp_path / FILE).stat().st_mode & 0o777 == 0o600
    command.change(dict.clear)
    assert running.sites() == ()
    assert SiteFile(tmp_path).sites() == ()


def test_nothing_is_written_where_an_edit_is_refused(tmp_path: Path) -> None:
    file = SiteFile(tmp_path)
    file.change(add)
    before = (tmp_path / FILE).read_bytes()

    def refuse(sites: dict[str, SiteSettings]) -> None:
        sites.clear()
        raise ConfigurationError("no")

    with pytest.raises(ConfigurationError, match="no"):
        file.change(refuse)
    assert (tmp_path / FILE).read_bytes() == before


def test_there_must_be_a_master(tmp_path: Path) -> None:
    with pytest.raises(ConfigurationError, match="there is no master") as caught:
        SiteFile(tmp_path / "none").change(add)
    assert "enroll" in caught.value.hint


def test_a_damaged_file_is_named(tmp_path: Path) -> None:
    (tmp_path / FILE).touch(0o600)
    (tmp_path / FILE).write_text("{")
    with pytest.raises(ConfigurationError, match=FILE):
        SiteFile(tmp_path).sites()

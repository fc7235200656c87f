import json
from pathlib import Path

import pytest

from rossec.cli.completion import seen

MASTER = "http://kitchen:11311"


@pytest.fixture
def home(tmp_path: Path) -> Path:
    path = tmp_path / "home"
    path.mkdir(mode=0o700)
    return path


def test_names_are_kept_for_the_owner_alone(home: Path) -> None:
    seen.keep(home, MASTER, {seen.TOPIC: ["/scan", "$(id)"], seen.NODE: ["/robot"]})
    assert seen.read(home, MASTER, seen.TOPIC) == ["/scan"]
    assert seen.read(home, MASTER, seen.NODE) == ["/robot"]
    assert seen.read(home, MASTER, seen.SERVICE) == []
    assert (home / seen.NAME).stat().st_mode & 0o777 == 0o600


def test_those_of_another_master_are_not_offered(home: Path) -> None:
    seen.keep(home, MASTER, {seen.TOPIC: ["/scan"]})
    assert seen.read(home, "http://attic:11311", seen.TOPIC) == []


@pytest.mark.parametrize(
    "content",
    ["", "[]", "{", '{"master": "M", "names": []}', '{"master": "M", "names": {"topic": 1}}'],
)
def test_what_is_damaged_has_no_names(home: Path, content: str) -> None:
    (home / seen.NAME).write_text(content)
    assert seen.read(home, "M", seen.TOPIC) == []


def test_what_others_could_have_written_is_not_read(home: Path) -> None:
    (home / seen.NAME).write_text(json.dumps({"master": MASTER, "names": {"topic": ["/x"]}}))
    (home / seen.NAME).chmod(0o622)
    assert seen.read(home, MASTER, seen.TOPIC) == []


def test_a_home_that_cannot_be_written_is_no_failure(home: Path, tmp_path: Path) -> None:
    seen.keep(tmp_path / "none", MASTER, {seen.TOPIC: ["/scan"]})
    (home / seen.NAME).symlink_to(tmp_path / "elsewhere")
    seen.keep(home, MASTER, {seen.TOPIC: ["/scan"]})
    assert not (tmp_path / "elsewhere").exists()

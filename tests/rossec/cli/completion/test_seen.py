import json
from pathlib import Path

import pytest

from rossec.cli.completion import values

MASTER = "http://kitchen:11311"


@pytest.fixture
def home(tmp_path: Path) -> Path:
    path = tmp_path / "home"
    path.mkdir(mode=0o700)
    return path


def test_names_are_kept_for_the_owner_alone(home: Path) -> None:
    values.keep(home, MASTER, {values.TOPIC: ["/scan", "$(id)"], values.NODE: ["/robot"]})
    assert values.read(home, MASTER, values.TOPIC) == ["/scan"]
    assert values.read(home, MASTER, values.NODE) == ["/robot"]
    assert values.read(home, MASTER, values.SERVICE) == []
    assert (home / values.NAME).stat().st_mode & 0o777 == 0o600


def test_those_of_another_master_are_not_offered(home: Path) -> None:
    values.keep(home, MASTER, {values.TOPIC: ["/scan"]})
    assert values.read(home, "http://attic:11311", values.TOPIC) == []


@pytest.mark.parametrize(
    "content", ["", "[]", "{", '{"master": "M", "names": []}', '{"master": "M", "names": {"topic": 1}}']
)
def test_what_is_damaged_has_no_names(home: Path, content: str) -> None:
    (home / values.NAME).write_text(content)
    assert values.read(home, "M", values.TOPIC) == []


def test_what_others_could_have_written_is_not_read(home: Path) -> None:
    (home / values.NAME).write_text(json.dumps({"master": MASTER, "names": {"topic": ["/x"]}}))
    (home / values.NAME).chmod(0o622)
    assert values.read(home, MASTER, values.TOPIC) == []


def test_a_home_that_cannot_be_written_is_no_failure(home: Path, tmp_path: Path) -> None:
    values.keep(tmp_path / "none", MASTER, {values.TOPIC: ["/scan"]})
    (home / values.NAME).symlink_to(tmp_path / "elsewhere")
    values.keep(home, MASTER, {values.TOPIC: ["/scan"]})
    assert not (tmp_path / "elsewhere").exists()

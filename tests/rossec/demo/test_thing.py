"""The demo's thing runs the example, and reports what it prints."""

import io
import json
import sys
from pathlib import Path

import pytest

from ca.things import read_ccs
from rossec.demo import thing
from rossec.errors import ConfigurationError


def test_lines_become_reports() -> None:
    out = io.StringIO()
    reporter = thing.Reporter(out)
    assert reporter.write("the light ") == 10
    reporter.flush()
    assert out.getvalue() == ""
    reporter.write("is on\nand\n")
    reporter.flush()
    assert [json.loads(line) for line in out.getvalue().splitlines()] == [
        {"said": "the light is on"},
        {"said": "and"},
    ]


def test_the_example_is_found_where_it_is(tmp_path: Path) -> None:
    assert thing.find().name == "thing.py"
    installed = tmp_path / "border"
    installed.mkdir()
    (installed / "thing.py").write_text("")
    assert thing.find([tmp_path / "nowhere", installed]) == installed / "thing.py"
    with pytest.raises(ConfigurationError, match="is missing"):
        thing.find([tmp_path])


def test_it_makes_its_key_in_its_directory(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "argv", [])
    monkeypatch.setattr(sys, "path", [*sys.path])
    monkeypatch.chdir(tmp_path)
    thing.main(str(tmp_path), ["lamp"])
    assert read_ccs((tmp_path / "lamp.ccs").read_bytes()).subject == "lamp"
    assert (tmp_path / "lamp.key").stat().st_mode & 0o777 == 0o600

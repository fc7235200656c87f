import importlib.util
from pathlib import Path

import pytest

from rossec.cli.shared import rules
from rossec.errors import ConfigurationError, MetadataRefused, NameUndefined, RossecError, RulesRefused
from rossec.naming import rule_runner
from rossec.naming.requests import MAX_INPUT
from tests.rossec.naming.stylesheets import gives


def test_the_shipped_rules_or_those_of_a_file(tmp_path: Path) -> None:
    assert rules.read_rules(None) == rule_runner.shipped_rules()
    path = tmp_path / "rules.xsl"
    path.write_bytes(gives("'/a'"))
    assert rules.read_rules(path) == gives("'/a'")
    path.write_bytes(b"<!DOCTYPE a><a/>")
    with pytest.raises(RulesRefused):
        rules.read_rules(path)
    path.write_bytes(bytes(300_000))
    with pytest.raises(ConfigurationError, match="larger than"):
        rules.read_rules(path)
    with pytest.raises(ConfigurationError, match="there is no"):
        rules.read_rules(tmp_path / "none")


def test_without_the_library_the_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(importlib.util, "find_spec", lambda _: None)
    with pytest.raises(RossecError) as caught:
        rules.read_rules(None)
    assert "rossec[names]" in caught.value.hint


def test_metadata_are_bounded_and_not_parsed(tmp_path: Path) -> None:
    path = tmp_path / "a.xml"
    path.write_bytes(b"<node>")
    assert rules.read_metadata(path) == b"<node>"
    path.write_bytes(b"<!DOCTYPE a><a/>")
    with pytest.raises(MetadataRefused):
        rules.read_metadata(path)
    path.write_bytes(b" " * (MAX_INPUT + 1))
    with pytest.raises(Exception, match=str(MAX_INPUT)):
        rules.read_metadata(path)


def test_the_name_of_a_node() -> None:
    lamp = b"<node><group>lamps</group><name>desk</name></node>"
    assert rules.name_of_node(rule_runner.shipped_rules(), lamp) == "/lamps/desk"
    with pytest.raises(NameUndefined):
        rules.name_of_node(rule_runner.shipped_rules(), b"<nothing/>")

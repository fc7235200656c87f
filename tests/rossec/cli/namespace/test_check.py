"""`rossec namespace check`: transcripts."""

import json
from pathlib import Path

import pytest

from grants.document import sign
from grants.model import Permission, Right
from rossec.cli import namespace as module
from tests.grants.authority import CA, draft
from tests.rossec.naming.stylesheets import PHONE, RULES, gives
from tests.support.commands import Shell, refused

TEMPERATURE = "/building1/room3/sensors/temperature"
LAMP = """<node><name>lamp</name>
<topic><name>temperature</name><function>sensor</function><location>building1/room3</location>
</topic></node>"""
POLICY = f"""rossec: 1
robot: r
identities: {{phones: {{node: /smartphones/schneider/*}}}}
rules:
  - {{id: a, who: phones, allow: {{publish: [{TEMPERATURE}]}}}}
"""


@pytest.fixture
def rules(tmp_path: Path) -> str:
    path = tmp_path / "rules.xsl"
    path.write_bytes(RULES)
    return str(path)


@pytest.fixture
def meta(tmp_path: Path) -> Path:
    path = tmp_path / "meta"
    path.mkdir()
    (path / "phone.xml").write_bytes(PHONE)
    (path / "read.me").write_text("not metadata")
    return path


def test_rules_without_findings(empty: Shell, rules: str, meta: Path) -> None:
    said = empty("namespace", "check", rules, "--meta", str(meta))
    assert (said.code, said.out) == (0, "3 names, 0 findings\n")
    assert "names were not compared with rights" in said.err


def test_findings_name_file_and_line(empty: Shell, rules: str, meta: Path) -> None:
    (meta / "lamp.xml").write_text(LAMP)
    said = empty("namespace", "check", rules, "--meta", str(meta))
    first, last = said.out.splitlines()
    assert first == (
        f"{meta}/phone.xml:13: the topic temperature: {TEMPERATURE} is also the topic temperature"
        f" in {meta}/lamp.xml:2"
    )
    assert last == "5 names, 1 findings"
    assert said.code == 1
    assert f"1 findings with the rules {rules}" in said.err


def test_findings_as_json(empty: Shell, rules: str, meta: Path) -> None:
    (meta / "lamp.xml").write_text("<node>")
    found = json.loads(empty("namespace", "check", rules, "--meta", str(meta), "--json").out)
    assert [each["what"] for each in found["findings"]] == ["metadata"]
    assert [each["name"] for each in found["names"] if each["which"] == "temperature"] == [TEMPERATURE]


def test_names_that_no_rule_of_a_policy_covers(empty: Shell, rules: str, meta: Path, tmp_path: Path) -> None:
    policy = tmp_path / "policy.yaml"
    policy.write_text(POLICY)
    said = empty("namespace", "check", rules, "--meta", str(meta), "--policy", str(policy))
    (line, last) = said.out.splitlines()
    assert last == "3 names, 1 findings"
    assert line.startswith(f"{meta}/phone.xml:7: the topic accelerometer: no grant or rule covers")
    assert "names were not compared" not in said.err


def test_names_that_no_grant_covers(empty: Shell, rules: str, meta: Path, tmp_path: Path) -> None:
    given = Permission("/smartphones/schneider/**", Right.PUBLISH)
    node = "/smartphones/schneider/htc_desire"
    (tmp_path / "a.grant").write_bytes(sign(CA, draft(given, subject=node)))
    said = empty("namespace", "check", rules, "--meta", str(meta), "--grants", str(tmp_path))
    assert [line.split(":")[1] for line in said.out.splitlines()[:-1]] == ["13"]


def test_what_cannot_be_checked_is_refused(
    empty: Shell, rules: str, meta: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    empty_folder = tmp_path / "empty"
    empty_folder.mkdir()
    refused(
        empty("namespace", "check", rules, "--meta", str(empty_folder)), "there are no metadata in", "*.xml"
    )
    bad = tmp_path / "bad.xsl"
    bad.write_bytes(gives("document(1)"))
    refused(
        empty("namespace", "check", str(bad), "--meta", str(meta)),
        "line 4: rules may not use the function document()",
    )
    monkeypatch.setattr(module, "MAX_METADATA_FILES", 0)
    refused(empty("namespace", "check", rules, "--meta", str(meta)), "1 files in", "")

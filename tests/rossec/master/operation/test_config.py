"""The configuration file: unknown keys are errors, and every error names its line."""

from pathlib import Path

import pytest

from rossec.errors import ConfigurationError
from rossec.master.operation.config import Config, MasterLimits, load, parse

FULL = """
port: 11312
log: json
audit: false
admin: true
announce: true
metrics: 9311
denial_log: /tmp/complaints
limits:
  body: 65536
  idle_seconds: 60
"""


def test_every_setting_is_read() -> None:
    assert parse(FULL, "m.yaml") == Config(
        port=11312,
        log="json",
        audit=False,
        admin=True,
        announce=True,
        metrics=9311,
        denial_log=Path("/tmp/complaints"),
        limits=MasterLimits(body=65536, idle_seconds=60),
    )


@pytest.mark.parametrize("text", ["", "# nothing\n", "{}"])
def test_an_empty_file_is_the_default(text: str) -> None:
    assert parse(text, "m.yaml") == Config()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("port: 1\nprot: 2", "m.yaml:2: there is no setting 'prot'"),
        ("port: 70000", "m.yaml:1: port cannot"),
        ("port: true", "m.yaml:1: port cannot"),
        ("port: 0x1z", "m.yaml:1: port cannot"),
        ("admin: 1", "m.yaml:1: admin cannot"),
        ("admin: 'no'", "m.yaml:1: admin cannot"),
        ("\nlog: xml", "m.yaml:2: log cannot"),
        ("denial_log: ''", "m.yaml:1: denial_log cannot"),
        ("metrics: -1", "m.yaml:1: metrics cannot"),
        ("1: 2", "m.yaml:1: there is no setting '1'"),
        ("limits: 5", "m.yaml:1: limits are a map"),
        ("limits:\n  bdoy: 5", "m.yaml:2: there is no limit 'bdoy'"),
        ("limits:\n  body: 0", "m.yaml:2: body must be"),
        ("limits:\n  body: 1.5", "m.yaml:2: body must be"),
        ("limits:\n  body: true", "m.yaml:2: body must be"),
        ("- port", "m.yaml: not a map"),
        ("port: 1\nport: 2", "m.yaml:2: duplicate key 'port'"),
        ("port: [", "m.yaml:1: not YAML"),
        ("\0", "m.yaml:1: not YAML"),
        ("port: &a 1\nmetrics: *a", "m.yaml:1: anchors and aliases"),
        ("<<: {port: 1}", "m.yaml:1: there is no setting '<<'"),
        ("port: !!python/object:os.system 1", "m.yaml:1: tags are not allowed"),
        ("port: !!int 1", "m.yaml:1: tags are not allowed"),
        (f"port: {'9' * 5000}", "m.yaml:1: port cannot"),
        (f"limits: {{body: {'9' * 5000}}}", "m.yaml:1: body must be"),
        ("port: 2026-02-30", "m.yaml:1: port cannot"),
        ("? [a]\n: 1", "m.yaml:1: a key must be a scalar"),
        ('denial_log: "a\\0b"', "m.yaml:1: denial_log cannot"),
        ('denial_log: "a\\u202eb"', "m.yaml:1: denial_log cannot"),
        ("[" + "1," * 2000 + "]", "m.yaml:1: more than 1000 YAML events"),
        ("[" * 5000, "m.yaml:1: nested deeper than 6"),
    ],
)
def test_errors_name_their_line(text: str, message: str) -> None:
    with pytest.raises(ConfigurationError) as caught:
        parse(text, "m.yaml")
    assert str(caught.value).startswith(message)


@pytest.mark.parametrize(
    ("text", "hint"),
    [
        ("port: '1'", "without quotes"),
        ("admin: yes", "true or false"),
        ("log: xml", "text or json"),
        ("denial_log: 5", "path of a file"),
        ("port: 1\nport: 2", "keep one of them"),
        ("limits: 5", "for example  body:"),
        ("prot: 1", "port, log, audit"),
    ],
)
def test_errors_name_valid_values(text: str, hint: str) -> None:
    with pytest.raises(ConfigurationError) as caught:
        parse(text, "m.yaml")
    assert hint in caught.value.hint


def test_a_file_is_read(tmp_path: Path) -> None:
    path = tmp_path / "m.yaml"
    with pytest.raises(ConfigurationError, match="there is no"):
        load(path)
    path.write_text(FULL)
    assert load(path).port == 11312
    path.write_bytes(b"# " + b"x" * 70000)
    with pytest.raises(ConfigurationError, match="larger"):
        load(path)

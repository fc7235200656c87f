"""`rossec namespace name`: transcripts."""

import json
from pathlib import Path

import pytest

from tests.rossec.naming.stylesheets import PHONE, gives
from tests.support.commands import Shell, refused


@pytest.fixture
def phone(tmp_path: Path) -> str:
    path = tmp_path / "phone.xml"
    path.write_bytes(PHONE)
    return str(path)


def test_the_names_of_the_thesis(empty: Shell, phone: str) -> None:
    name = ("namespace", "name", phone)
    assert empty(*name).out == "/smartphones/schneider/htc_desire\n"
    topic = (*name, "--topic", "accelerometer")
    assert empty(*topic).out == "/smartphones/schneider/htc_desire/sensors/accelerometer\n"
    said = empty(*name, "--topic", "temperature", "--json")
    assert json.loads(said.out) == {
        "kind": "topic",
        "which": "temperature",
        "name": "/building1/room3/sensors/temperature",
    }


def test_a_service_has_a_name(empty: Shell, tmp_path: Path) -> None:
    path = tmp_path / "lamp.xml"
    path.write_text("<node><service><name>reset</name><location>room</location></service></node>")
    assert empty("namespace", "name", str(path), "--service", "reset").out == "/room/reset\n"


def test_defaults_are_legal_unless_those_of_the_thesis_are_asked_for(empty: Shell, tmp_path: Path) -> None:
    path = tmp_path / "nothing.xml"
    path.write_text("<node/>")
    assert empty("namespace", "name", str(path)).out == "/unknown_group/unknown_node\n"
    said = empty("namespace", "name", str(path), "--thesis-defaults")
    assert said.out == "/unknown-group/unknown-node\n"


def test_other_rules_give_other_names(empty: Shell, phone: str, tmp_path: Path) -> None:
    rules = tmp_path / "rules.xsl"
    rules.write_bytes(gives("concat('/', /node/name)"))
    assert empty("namespace", "name", phone, "--rules", str(rules)).out == "/htc_desire\n"
    rules.write_bytes(gives("document('/etc/passwd')"))
    refused(
        empty("namespace", "name", phone, "--rules", str(rules)),
        "line 4: rules may not use the function document()",
        "XSLT 1.0",
    )


def test_what_is_asked_for_must_be_there(empty: Shell, phone: str, tmp_path: Path) -> None:
    refused(
        empty("namespace", "name", phone, "--topic", "x"),
        "the rules give no name for the topic 'x'",
        "is it in the metadata?",
    )
    both = empty("namespace", "name", phone, "--topic", "x", "--service", "y")
    refused(both, "give --topic or --service, not both", code=2)
    large = tmp_path / "large.xml"
    large.write_bytes(bytes(300_000))
    refused(empty("namespace", "name", str(large)), "is larger than 262144 bytes")


def test_without_the_library_it_says_what_to_install(
    empty: Shell, phone: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("importlib.util.find_spec", lambda _: None)
    refused(empty("namespace", "name", phone), "names by rules need lxml", "rossec[names]")

import dataclasses

import click
import pytest
from click.testing import CliRunner

from ca.errors import PatternRefused
from rossec.cli import domain as trust
from rossec.errors import ConfigurationError
from tests.vectors.make_domains import ENTRY, OTHER


def test_masters_and_relays_are_admitted_with_the_nodes() -> None:
    assert trust.admitted(["/b", "/a", "/a"]) == ("/a", "/b", *trust.OF_MASTERS, *trust.OF_RELAYS)
    with pytest.raises(PatternRefused):
        trust.admitted(["a"])


@pytest.mark.parametrize(
    ("texts", "rules"),
    [
        (("everything",), None),
        (("nothing",), ()),
        (("/a subscribe",), (("/a", 2),)),
        (("/b call", "/a publish, subscribe"), (("/a", 3), ("/b", 4))),
        (("/a all",), (("/a", 255),)),
        (("/a param-get,graph",), (("/a", 80),)),
    ],
)
def test_rules_are_read(texts: tuple[str, ...], rules: object) -> None:
    assert trust.read_rules(texts) == rules


@pytest.mark.parametrize("text", ["", "/a", "/a ,", "/a fly", "everything", "nothing /a"])
def test_what_is_no_rule(text: str) -> None:
    with pytest.raises((ConfigurationError, PatternRefused)):
        trust.read_rules(("/x call", text))


@pytest.mark.parametrize(
    ("seconds", "text"), [(86400, "1d"), (7200, "2h"), (90, "90s"), (120, "2m"), (90000, "25h")]
)
def test_durations_are_written_as_they_are_given(seconds: int, text: str) -> None:
    assert trust.duration(seconds) == text


def test_terms_for_people_and_for_programs() -> None:
    lines = "\n".join(trust.lines(ENTRY))
    assert "  shown to it: /robot/** (subscribe)" in lines
    assert "  taken from it: nothing" in lines
    assert "admits /rounds/**\n" in lines  # /master alone: not all masters
    assert "admits no node, and its masters" in "\n".join(
        trust.lines(dataclasses.replace(OTHER, admitted=trust.OF_MASTERS))
    )
    both = dataclasses.replace(OTHER, admitted=trust.admitted(["/a"]))
    assert "admits /a, and its masters and relays" in "\n".join(trust.lines(both))
    shown = trust.as_json(ENTRY)
    assert shown["exported"] == [{"pattern": "/robot/**", "rights": ["subscribe"]}]
    assert shown["imported"] == []
    assert trust.as_json(OTHER)["exported"] is None


def test_a_word_on_revocations_cannot_be_fresher_than_it_is_asked_for() -> None:
    assert trust.check_fresh(30) == 30
    with pytest.raises(ConfigurationError, match="29s is too short"):
        trust.check_fresh(29)


def test_the_options_of_a_command() -> None:
    seen: dict[str, object] = {}

    @click.command()
    @trust.admit
    @trust.fresh("1h")
    @trust.lifetime(None)
    @trust.rules
    def command(**given: object) -> None:
        seen.update(given)

    done = CliRunner().invoke(command, ["--admit", "/a", "--export", "x", "--import", "y"])
    assert done.exit_code == 0
    assert seen == {"admit": ("/a",), "fresh": 3600, "lifetime": None, "exported": ("x",), "imported": ("y",)}
    assert CliRunner().invoke(command, ["--fresh", "8d"]).exit_code == 2

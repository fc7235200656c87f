import dataclasses

import click
import pytest
from click.testing import CliRunner

from ca.errors import PatternRefused
from rossec.cli.domain import terms
from rossec.errors import ConfigurationError
from tests.vectors.make_domains import ENTRY, OTHER


def test_masters_and_relays_are_admitted_with_the_nodes() -> None:
    assert terms.admitted(["/b", "/a", "/a"]) == ("/a", "/b", *terms.OF_MASTERS, *terms.OF_RELAYS)
    with pytest.raises(PatternRefused):
        terms.admitted(["a"])


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
    assert terms.read_rules(texts) == rules


@pytest.mark.parametrize("text", ["", "/a", "/a ,", "/a fly", "everything", "nothing /a"])
def test_what_is_no_rule(text: str) -> None:
    with pytest.raises((ConfigurationError, PatternRefused)):
        terms.read_rules(("/x call", text))


@pytest.mark.parametrize(
    ("seconds", "text"), [(86400, "1d"), (7200, "2h"), (90, "90s"), (120, "2m"), (90000, "25h")]
)
def test_durations_are_written_as_they_are_given(seconds: int, text: str) -> None:
    assert terms.duration(seconds) == text


def test_terms_for_people_and_for_programs() -> None:
    lines = "\n".join(terms.lines(ENTRY))
    assert "  shown to it: /robot/** (subscribe)" in lines
    assert "  taken from it: nothing" in lines
    assert "admits /rounds/**\n" in lines  # /master alone: not all masters
    assert "admits no node, and its masters" in "\n".join(
        terms.lines(dataclasses.replace(OTHER, admitted=terms.OF_MASTERS))
    )
    both = dataclasses.replace(OTHER, admitted=terms.admitted(["/a"]))
    assert "admits /a, and its masters and relays" in "\n".join(terms.lines(both))
    shown = terms.as_json(ENTRY)
    assert shown["exported"] == [{"pattern": "/robot/**", "rights": ["subscribe"]}]
    assert shown["imported"] == []
    assert terms.as_json(OTHER)["exported"] is None


def test_a_word_on_revocations_cannot_be_fresher_than_it_is_asked_for() -> None:
    assert terms.check_fresh(30) == 30
    with pytest.raises(ConfigurationError, match="29s is too short"):
        terms.check_fresh(29)


def test_the_options_of_a_command() -> None:
    seen: dict[str, object] = {}

    @click.command()
    @terms.admit
    @terms.fresh("1h")
    @terms.lifetime(None)
    @terms.rules
    def command(**given: object) -> None:
        seen.update(given)

    done = CliRunner().invoke(command, ["--admit", "/a", "--export", "x", "--import", "y"])
    assert done.exit_code == 0
    assert seen == {
        "admit": ("/a",), "fresh": 3600, "lifetime": None, "exported": ("x",), "imported": ("y",),
    }  # fmt: skip
    assert CliRunner().invoke(command, ["--fresh", "8d"]).exit_code == 2

import click
import pytest

from rossec.cli.gateway_words import split
from rossec.errors import ConfigurationError
from rossec.gateway.rules import TopicRule
from rossec.participant.delivery_options import DeliveryOptions


def test_options_are_about_the_patterns_of_their_from() -> None:
    words = (
        "--name /gateway/attic --from ada /robot/pose /robot/tf --rate 5 --newest"
        " --from ada --rate=0.5 /robot/camera --compress --from=ben /**"
    )
    rules, rest = split(words.split())
    assert rules == (
        TopicRule("ada", "/robot/pose", DeliveryOptions(rate=5, newest=True)),
        TopicRule("ada", "/robot/tf", DeliveryOptions(rate=5, newest=True)),
        TopicRule("ada", "/robot/camera", DeliveryOptions(rate=0.5, deflate=True)),
        TopicRule("ben", "/**"),
    )
    assert rest == ["--name", "/gateway/attic"]


def test_another_option_ends_a_from() -> None:
    rules, rest = split(["--from", "ada", "/x", "--json", "status", "--rate", "5"])
    assert rules == (TopicRule("ada", "/x"),)
    assert rest == ["--json", "status", "--rate", "5"]


@pytest.mark.parametrize(
    ("words", "says"),
    [
        ("--from", "--from needs a value"),
        ("--from --rate 5", "--from needs a value"),
        ("--from ada", "--from ada names no topics"),
        ("--from /robot/pose", "takes a label, and then patterns"),
        ("--from ada:/robot/pose", "takes a label, and then patterns"),
        ("--from ada --from ben /x", "--from ada names no topics"),
        ("--from ada /x --rate", "--rate needs a value"),
        ("--from ada /x --rate fast", "messages a second, not 'fast'"),
        ("--from ada " + " ".join(f"/t{n}" for n in range(257)), "257 patterns: at most 256"),
    ],
)
def test_words_that_are_missing_or_wrong(words: str, says: str) -> None:
    with pytest.raises(click.UsageError, match=says):
        split(words.split())


def test_a_rate_that_is_none_is_refused() -> None:
    with pytest.raises(ConfigurationError, match="a rate of nan"):
        split(["--from", "ada", "/x", "--rate", "nan"])

"""Parts of the expected kind; anything else is a mistake with a hint."""

from typing import Any

import pytest

from grants.model import Right
from grants.policy import source
from grants.policy.source import Mistakes, Part, YamlMapping, YamlScalar, YamlSequence

MISTAKES = Mistakes("p.yaml")


@pytest.fixture
def mistakes() -> Mistakes:
    MISTAKES.found.clear()
    return MISTAKES


def scalar(value: Any) -> YamlScalar:
    return YamlScalar(3, 7, MISTAKES, value)


SEQUENCE = YamlSequence(3, 7, MISTAKES, (scalar("a"),))
MAPPING = YamlMapping(3, 7, MISTAKES, {"a": (scalar("a"), scalar(1))})


def only(mistakes: Mistakes) -> tuple[str, str]:
    (found,) = mistakes.found
    assert (found.line, found.column) == (3, 7)
    return found.message, found.hint


def test_missing_parts_are_no_mistake(mistakes: Mistakes) -> None:
    assert source.mapping(None, "x") is None
    assert source.text(None, "x") is None
    assert source.duration(None, "x") is None
    assert source.pattern(None, "x") is None
    assert source.key(None) is None
    assert source.number(None, "x") is None
    assert source.choice(None, "x", ()) is None
    assert source.items(None) == ()
    assert mistakes.found == []


def test_mappings(mistakes: Mistakes) -> None:
    assert source.mapping(MAPPING, "x") is MAPPING
    assert source.mapping(SEQUENCE, "x") is None
    assert only(mistakes) == ("x must be a mapping", "write key: value")


def test_unknown_and_missing_keys(mistakes: Mistakes) -> None:
    source.check_keys(MAPPING, "x", ("a", "b"), ("b",))
    assert only(mistakes) == ("x has no 'b'", "add b: ...")
    source.check_keys(MAPPING, "x", ("a",), ("a",))
    source.check_keys(MAPPING, "x", ("b", "aa"), ())
    assert (mistakes.found[1].message, mistakes.found[1].hint) == (
        "unknown key 'a' in x",
        "did you mean 'aa'?",
    )


def test_items_of_a_sequence_or_one() -> None:
    assert source.items(SEQUENCE) == SEQUENCE.items
    assert source.items(MAPPING) == (MAPPING,)


@pytest.mark.parametrize("part", [scalar(""), scalar(5), scalar(True), scalar("x" * 1001), SEQUENCE])
def test_texts(part: Part, mistakes: Mistakes) -> None:
    assert source.text(scalar("fine"), "x") == "fine"
    assert source.text(part, "x") is None
    assert only(mistakes)[1] == "put it in quotes"


@pytest.mark.parametrize(
    ("text", "seconds"), [("30s", 30), ("15m", 900), ("8h", 28800), ("7d", 604800), ("4w", 2419200)]
)
def test_durations(text: str, seconds: int, mistakes: Mistakes) -> None:
    assert source.duration(scalar(text), "x") == seconds


@pytest.mark.parametrize("value", ["never", "7", 7, "0s", "-1d", "1000000d", "7d ", "\u0667d", True])
def test_invalid_durations(value: object, mistakes: Mistakes) -> None:
    assert source.duration(scalar(value), "x") is None
    assert only(mistakes)[1] == "write 30s, 15m, 8h, 7d or 4w"


def test_never_is_read_if_allowed(mistakes: Mistakes) -> None:
    assert source.duration(scalar("never"), "x", never=True) == 0
    assert source.duration(SEQUENCE, "x", never=True) is None
    assert only(mistakes) == ("x is not a duration", "write 30s, 15m, 8h, 7d or 4w, or never")


def test_patterns(mistakes: Mistakes) -> None:
    assert source.pattern(scalar("/a/**"), "x") == "/a/**"
    assert source.pattern(scalar("~a"), "x") is None
    assert only(mistakes)[0].startswith("x: not a name pattern: '~a'")


@pytest.mark.parametrize("value", ["sha256:12", "ab" * 32, "sha256:" + "AB" * 32, 5])
def test_keys(value: object, mistakes: Mistakes) -> None:
    assert source.key(scalar("sha256:" + "ab" * 32)) == bytes([0xAB]) * 32
    assert source.key(scalar(value)) is None
    assert "64 hexadecimal digits" in only(mistakes)[1]


@pytest.mark.parametrize("value", [0, -1, True, "1", 1e9, float("inf"), float("nan")])
def test_numbers(value: object, mistakes: Mistakes) -> None:
    assert source.number(scalar(0.2), "x") == 0.2
    assert source.number(scalar(value), "x") is None
    assert only(mistakes)[1] == "for example 0.2"


def test_choices(mistakes: Mistakes) -> None:
    assert source.choice(scalar("deny"), "decision", ("deny", "prompt")) == "deny"
    assert source.choice(scalar("promt"), "decision", ("deny", "prompt")) is None
    assert only(mistakes) == ("unknown decision: 'promt'", "did you mean 'prompt'?")


def test_a_sequence_is_not_a_choice(mistakes: Mistakes) -> None:
    assert source.choice(SEQUENCE, "decision", ("deny",)) is None
    assert only(mistakes) == ("unknown decision", "expected one of deny")


def test_an_own_pattern_is_of_names_of_this_domain(mistakes: Mistakes) -> None:
    assert source.own_pattern(scalar("/robot/*"), "x", Right.CALL) == "/robot/*"
    assert source.own_pattern(scalar("/remote/**"), "x", Right.GRAPH) == "/remote/**"
    assert source.own_pattern(None, "x", Right.CALL) is None
    assert mistakes.found == []


@pytest.mark.parametrize(
    ("text", "right"),
    [
        ("hospital:/robot/pose", Right.SUBSCRIBE),
        ("hospital:/**", Right.GRAPH),
        ("/remote/hospital/robot/pose", Right.SUBSCRIBE),
    ],
)
def test_a_right_on_names_of_others_is_their_authoritys(text: str, right: Right, mistakes: Mistakes) -> None:
    assert source.own_pattern(scalar(text), "x", right) is None
    assert "is a name of another domain" in only(mistakes)[0]


def test_a_subject_of_another_domain_is_written_with_its_label(mistakes: Mistakes) -> None:
    assert source.subject(scalar("/robot/*"), "x") == "/robot/*"
    assert source.subject(scalar("hospital:/rounds/*"), "x") == "/remote/hospital/rounds/*"
    assert source.subject(None, "x") is None
    assert mistakes.found == []


@pytest.mark.parametrize("text", ["/remote/hospital/rounds/*", "hospital:", "a b:/c", "robot"])
def test_another_form_of_a_subject_is_a_mistake(text: str, mistakes: Mistakes) -> None:
    assert source.subject(scalar(text), "x") is None
    assert only(mistakes)[1]


def test_entries_are_unique_by_what_their_keys_stand_for(mistakes: Mistakes) -> None:
    entries: dict[str, tuple[YamlScalar, Part]] = {
        text: (scalar(text), scalar(number)) for number, text in enumerate("aAb")
    }
    part = YamlMapping(3, 7, MISTAKES, entries)

    def read(key: YamlScalar) -> str | None:
        return None if key.value == "b" else str(key.value).lower()

    found = [(name, value) for name, _, value in source.by_name(part, "x", read)]
    assert found == [("a", entries["a"][1])]
    assert only(mistakes) == ("x: 'a' a second time, first in 3:7", "keep one of them")
    assert list(source.by_name(None, "x", read)) == []

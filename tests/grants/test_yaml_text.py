"""YAML text as events and values: bounded in structure, and limited to the subset."""

import contextlib
import math
from datetime import datetime

import pytest
from hypothesis import given
from hypothesis import strategies as st

from grants.errors import YamlRefused
from grants.policy import source
from grants.policy.source import Bounds, load_yaml


def refusal(text: str, bounds: Bounds | None = None) -> YamlRefused:
    with pytest.raises(YamlRefused) as caught:
        load_yaml(text, bounds)
    return caught.value


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("", None),
        ("# nothing", None),
        ("~", None),
        ("null", None),
        ("''", ""),
        ("{}", {}),
        ("5", 5),
        ("+5", 5),
        ("-5", -5),
        ("0x1F", 31),
        ("0o17", 15),
        ("18446744073709551615", 2**64 - 1),
        ("2.5", 2.5),
        (".5", 0.5),
        ("1e3", 1000.0),
        ("-.inf", -math.inf),
        (".inf", math.inf),
        ("true", True),
        ("FALSE", False),
        ("yes", "yes"),
        ("1_000", "1_000"),
        ("'5'", "5"),
        ("[1, a]", [1, "a"]),
        ("{a: {b: [1]}}", {"a": {"b": [1]}}),
        ("{1: 2}", {1: 2}),
        ("2026-01-02 03:04:05", datetime(2026, 1, 2, 3, 4, 5)),  # noqa: DTZ001 - XML-RPC has no zone
        ("2026-02-30 03:04:05", "2026-02-30 03:04:05"),
        ("2026-13-45", "2026-13-45"),
        ("!!str 5", "5"),
        ("!!float 5", 5.0),
        ("!!int '5'", 5),
        ("! 5", 5),
        ("!!null ''", None),
        ("!!bool true", True),
        ("!!binary aGk=", b"hi"),
        ("{<<: {a: 1}, b: 2}", {"<<": {"a": 1}, "b": 2}),
        ("9" * 21, 1e21),
    ],
)
def test_a_document_has_its_value(text: str, value: object) -> None:
    found = load_yaml(text)
    assert (found, type(found)) == (value, type(value))


def test_nan_is_a_float() -> None:
    found = load_yaml(".nan")
    assert isinstance(found, float)
    assert math.isnan(found)


@pytest.mark.parametrize(
    ("text", "position", "message"),
    [
        ("a: &x 1\nb: *x", (1, 4), "anchors and aliases are not allowed"),
        ("a: 1\nb: *x", (2, 4), "anchors and aliases are not allowed"),
        ("a: !!python/object:os.system x", (1, 4), "tags are not allowed"),
        ("!!map {a: 1}", (1, 1), "tags are not allowed"),
        ("a: !!int x", (1, 4), "'x' is not a valid int"),
        ("a: !!binary '*'", (1, 4), "'*' is not a valid binary"),
        ("%YAML 1.1\n---\na", (2, 1), "directives are not allowed"),
        ("a\n---\nb", (2, 1), "more than one document"),
        ("[" * 5000, (1, 17), "nested deeper than 16"),
        ("{a: 1, a: 2}", (1, 8), "duplicate key 'a'"),
        ("{[a]: 1}", (1, 2), "a key must be a scalar"),
        ("[", (1, 2), "not YAML: expected the node content"),
        ("\0", (1, 1), "not YAML: "),
    ],
)
def test_text_outside_the_subset_is_refused(text: str, position: tuple[int, int], message: str) -> None:
    error = refusal(text)
    assert str(error).startswith(message)
    assert (error.line, error.column) == position


@pytest.mark.parametrize(
    ("text", "hint"),
    [
        ("a:\n\t- b", "indent with spaces"),
        ("who: *", "put text that begins with * or & in quotes"),
        ("{why: because: so}", "put text with a colon in quotes"),
        ("why: because: so", "put text with a colon in quotes"),
        ("- a\n b: 1\n  c", "check the indentation"),
    ],
)
def test_usual_mistakes_are_told_with_their_remedy(text: str, hint: str) -> None:
    assert refusal(text).hint.find(hint) >= 0


def test_size_depth_and_events_are_bounded() -> None:
    assert "5 characters where at most 4" in str(refusal("aaaaa", Bounds(size=4)))
    assert "deeper than 1" in str(refusal("[[1]]", Bounds(depth=1)))
    many = "[" + "1," * 50 + "]"
    assert "more than 40 YAML events" in str(refusal(many, Bounds(events=40)))
    assert load_yaml(many, Bounds(events=60)) == [1] * 50


def test_a_large_text_is_refused_before_it_is_parsed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(source, "YAML", None)
    assert "where at most" in str(refusal("a" * (Bounds().size + 1)))


@given(st.text(alphabet="ab1.:{}[],&*!|>'\"-? \n#%\t<=~", max_size=40))
def test_any_text_is_read_or_refused(text: str) -> None:
    with contextlib.suppress(YamlRefused):
        load_yaml(text)

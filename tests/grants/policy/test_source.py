"""YAML text to parts: positions, refusals, and scalars that stay as written."""

import contextlib

import pytest
from hypothesis import given
from hypothesis import strategies as st

from grants.errors import PolicyRefused
from grants.policy import source
from grants.policy import source as yaml_text
from grants.policy.source import Mistakes, YamlMapping, YamlScalar, YamlSequence, read_source


def read(text: str) -> object:
    mistakes = Mistakes("p.yaml")
    part = read_source(text, mistakes)
    mistakes.raise_if_any()
    return part


def refusal(text: str) -> str:
    with pytest.raises(PolicyRefused) as caught:
        read(text)
    return str(caught.value)


def test_every_part_has_its_position() -> None:
    part = read("a: 1\nb:\n  - x\n  - {c: d}\n")
    assert isinstance(part, YamlMapping)
    row = part.get("b")
    assert isinstance(row, YamlSequence)
    inner = row.items[1]
    assert isinstance(inner, YamlMapping)
    key, value = inner.entries["c"]
    assert (key.line, key.column) == (4, 6)
    assert isinstance(value, YamlScalar)
    assert (value.value, value.line, value.column) == ("d", 4, 9)
    assert part.get("absent") is None


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("22:00", "22:00"),
        ("no", "no"),
        ("on", "on"),
        ("2026-11-20", "2026-11-20"),
        ("0x10", "0x10"),
        ("~", "~"),
        ("", ""),
        ("'5'", "5"),
        ('"true"', "true"),
        ("5", 5),
        ("-5", -5),
        ("2.5", 2.5),
        (".5", 0.5),
        ("1e3", 1000.0),
        ("1_000", "1_000"),
        ("true", True),
        ("false", False),
        (".nan", ".nan"),
        (".inf", ".inf"),
    ],
)
def test_plain_scalars_stay_as_written(text: str, value: object) -> None:
    part = read(f"a: {text}")
    assert isinstance(part, YamlMapping)
    word = part.get("a")
    assert isinstance(word, YamlScalar)
    assert (word.value, type(word.value)) == (value, type(value))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("a: &x 1\nb: *x", "p.yaml:1:4: anchors and aliases are not allowed"),
        ("a: *x", "p.yaml:1:4: anchors and aliases are not allowed"),
        ("a: !!int 1", "p.yaml:1:4: tags are not allowed"),
        ("a: !mine [1]", "p.yaml:1:4: tags are not allowed"),
        ("%YAML 1.1\n---\na: no", "p.yaml:2:1: directives are not allowed"),
        ("%TAG ! tag:x,2000:\n---\na: 1", "p.yaml:2:1: directives are not allowed"),
        ("a: 1\n---\nb: 2\n", "p.yaml:2:1: more than one document"),
        ("[" * 20, "p.yaml:1:17: nested deeper than 16"),
        ("[" * 100_000, "p.yaml:1:17: nested deeper than 16"),
        ("a: [1\nb: 2", "p.yaml:2:2: not YAML: expected ',' or ']', but got ':'"),
        ("a: \x00", "p.yaml:1:1: not YAML: unacceptable character #x0000"),
        ("a: 1\nb: 2\na: 3", "p.yaml:3:1: duplicate key 'a', first in 1:1"),
        ("? [a]\n: 1", "p.yaml:1:3: a key must be a scalar"),
    ],
)
def test_text_outside_the_subset_is_refused_with_its_position(text: str, message: str) -> None:
    assert refusal(text).startswith(message)


def test_a_large_file_is_refused_before_it_is_parsed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(yaml_text, "YAML", None)
    assert "where at most" in refusal("a" * (source.MAX_SIZE + 1))


def test_an_empty_file_has_no_part() -> None:
    assert read("") is None
    assert read("# only a comment\n") is None


def test_a_list_at_the_top_is_read(monkeypatch: pytest.MonkeyPatch) -> None:
    assert isinstance(read("- 1\n- 2"), YamlSequence)


@given(st.text(max_size=60))
def test_any_text_is_read_or_refused(text: str) -> None:
    with contextlib.suppress(PolicyRefused):
        read(text)


@given(st.text(alphabet="ab:{}[],&*!|>'\"-? \n#%\t", max_size=40))
def test_any_yaml_like_text_is_read_or_refused(text: str) -> None:
    with contextlib.suppress(PolicyRefused):
        read(text)


@pytest.mark.parametrize(
    "text", ["a: {node}/pose\n", "a: [{node}/pose]\n", "a:\n  - {node}/**\n", "b: 1\na: [x, {node}/y]"]
)
def test_own_names_without_quotes_say_what_to_write(text: str) -> None:
    with pytest.raises(PolicyRefused, match=r"^p.yaml:[12]:") as refused:
        read(text)
    assert '"{node}/pose"' in refused.value.hint
    assert "~/pose" in refused.value.hint


def test_own_names_in_quotes_or_short_are_texts() -> None:
    part = read("a: [\"{node}/pose\", '{node}', ~/pose, ~/**]\n")
    assert isinstance(part, YamlMapping)
    row = part.get("a")
    assert isinstance(row, YamlSequence)
    assert [each.value for each in row.items if isinstance(each, YamlScalar)] == [
        "{node}/pose",
        "{node}",
        "~/pose",
        "~/**",
    ]

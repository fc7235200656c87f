"""Random input to every decoder of grants: a result or an error of `grants`."""

from contextlib import suppress

from hypothesis import given, settings
from hypothesis import strategies as st

from grants.conditions.compile import compile_condition
from grants.errors import ConditionRefused, DefinitionRefused, FilterRefused, MessageRefused
from grants.filters.compile import compile_filter
from grants.filters.layout import Layout, parse
from grants.model import FilterRule
from tests.grants.messages import EVERYTHING, LAYOUT, SEPARATOR

WORDS = (
    "int32",
    "string",
    "Header",
    "time",
    "float64[]",
    "N",
    "N[]",
    "N[3]",
    "t/N[4294967296]",
    "a",
    "b",
    "]",
    "\0",
    "é",
    " ",
    "\n",
    "#",
    "=",
    "1",
    f"\n{SEPARATOR}\nMSG: t/N\n",
    f"\n{SEPARATOR}\nMSG: ",
    "[",
)
definitions = st.lists(st.sampled_from(WORDS), max_size=25).map(" ".join) | st.text(max_size=60)
tokens = st.sampled_from(
    (
        "msg.flag",
        "msg.f64",
        "msg.text",
        "msg.i8",
        "now",
        "timestamp",
        ".getHours",
        "(",
        ")",
        "[",
        "]",
        ",",
        "!",
        "-",
        "*",
        "+",
        "&&",
        "||",
        "==",
        "<",
        "in",
        '"a"',
        "1",
        "2.5",
        "9223372036854775808",
        "true",
        ".startsWith",
        '"Europe/Zurich"',
        "\\",
        "é",
        "__class__",
    )
)
conditions = st.lists(tokens, max_size=20).map(" ".join) | st.text(max_size=60)


@settings(max_examples=500)
@given(definitions, st.binary(max_size=80))
def test_random_definitions_and_messages(text: str, message: bytes) -> None:
    with suppress(DefinitionRefused, MessageRefused, FilterRefused):
        shape = parse("t/T", text)
        rules = [FilterRule(name, "clear") for name, _ in shape.root.fields]
        made = compile_filter(shape, rules)(message)
        assert sum(map(len, made)) <= max(len(message), 1 << 16)


@settings(max_examples=300)
@given(st.integers(0, len(EVERYTHING)), st.sampled_from(WORDS), st.integers(0, 5))
def test_damaged_definitions_are_parsed_or_refused(at: int, word: str, cut: int) -> None:
    with suppress(DefinitionRefused):
        found = parse("test_msgs/Everything", EVERYTHING[:at] + word + EVERYTHING[at + cut :])
        assert isinstance(found, Layout)


@settings(max_examples=500)
@given(conditions, st.binary(max_size=200), st.integers(-(1 << 62), 1 << 62))
def test_random_conditions(text: str, message: bytes, now: int) -> None:
    with suppress(ConditionRefused):
        assert compile_condition(LAYOUT, text)(message, now) in (True, False)

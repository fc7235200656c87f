"""Conditions: their value, what denies, what the compiler refuses."""

import math
import struct
from typing import Any

import pytest

from grants.conditions.compile import check_syntax, compile_condition
from grants.errors import ConditionRefused
from tests.grants.messages import LAYOUT, layout, seeded_random, text

NOW = 1_800_000_000  # 2027-01-15 08:00:00 UTC, a Friday
SHAPE = layout(
    "bool on\nN[] skipped\nint32 count\nfloat64 x\nfloat32 f\nstring frame\nuint64 big\nN inner\n"
    "time stamp\nfloat64[] values",
    "MSG: t/N\nstring name\nint8 level",
)


def message(
    x: float = 1.5, count: int = -3, frame: str = "map", name: str = "motör", big: int = 2**63
) -> bytes:
    skipped = b"\2\0\0\0" + (text("one") + b"\1") * 2
    head = b"\1" + skipped + struct.pack("<idf", count, x, 0.25) + text(frame)
    return head + struct.pack("<Q", big) + text(name) + b"\5" + bytes(12)


def holds(source: str, data: bytes | memoryview | None = None, now: int = NOW) -> bool:
    return compile_condition(SHAPE, source)(message() if data is None else data, now)


TRUE = [
    "true",
    "msg.on",
    "!false",
    "!!msg.on",
    "msg.count == -3",
    "msg.count < 0 && msg.x > 1.0",
    "msg.count > 0 || msg.x > 1.0",
    "msg.x == 1.5",
    "msg.x > 1",
    "msg.count <= -2.5",
    "msg.f == 0.25",
    'msg.frame == "map"',
    "msg.frame != 'odom'",
    'msg.frame in ["odom", "map"]',
    "msg.count in [1, -3]",
    "!(msg.count in [1, 2])",
    'msg.frame.startsWith("m") && msg.frame.endsWith("ap") && msg.frame.contains("a")',
    'msg.inner.name == "mot\\u00f6r"',
    "msg.inner.name.contains(msg.inner.name)",
    "msg.inner.level == 5",
    "msg.big > 9223372036854775807",
    "msg.count * 2 + 1 == -5",
    "1 - 2 - 3 == -4",
    "1 + 2 * 3 == 7",
    "(1 + 2) * 3 == 9",
    "-(1 + 2) == -3",
    "--1 == 1",
    "1.5e1 == 15.0 && 1E2 == 100.0",
    "msg.x * 2.0 - 1.0 == 2.0",
    "true || false && false",
    "(true == true) != false",
    'now < timestamp("2027-01-15T08:00:01Z")',
    'now == timestamp("2027-01-15T09:00:00+01:00")',
    "now.getHours() == 8 && now.getMinutes() == 0 && now.getSeconds() == 0",
    'now.getHours("Europe/Zurich") == 9',
    "now.getDayOfWeek() == 5",
    "now.getFullYear() == 2027 && now.getMonth() == 0 && now.getDate() == 15",
    "now.getDayOfMonth() == 14 && now.getDayOfYear() == 14",
    'timestamp("2027-07-01T22:30:00Z").getHours("Europe/Zurich") == 0',
    "  msg.on\t&&\n true  ",
]
FALSE = [
    "false",
    "msg.x < 1.0",
    'msg.frame == "ma"',
    "msg.count in []",
    "1 == 2 || msg.count == 0",
    'now >= timestamp("2027-01-15T08:00:01Z")',
    "9223372036854775807 + 1 > 0",  # overflow: an error
    "-9223372036854775807 - 2 < 0",
    "msg.big * 2 > 0",
    "1e308 * 10.0 > 0.0",
]


@pytest.mark.parametrize("source", TRUE)
def test_a_true_condition_admits(source: str) -> None:
    assert holds(source)
    assert not holds(f"!({source})")


@pytest.mark.parametrize("source", FALSE)
def test_a_false_condition_denies(source: str) -> None:
    assert not holds(source)


def test_nan_in_a_named_field_denies() -> None:
    data = message(x=math.nan)
    for source in ("msg.x > 0.0", "!(msg.x > 0.0)", "msg.x != 0.0", "true || msg.x > 0.0"):
        assert not holds(source, data)
    assert holds("msg.count == -3", data)


def test_infinity_can_be_compared_but_not_computed_with() -> None:
    data = message(x=math.inf)
    assert holds("msg.x > 1.0", data)
    for source in ("msg.x - msg.x == 0.0", "msg.x + 1.0 > 0.0", "-msg.x < 0.0"):
        assert not holds(source, data)


def test_truncated_messages_deny_and_later_fields_are_not_read() -> None:
    for source, field_end in ((TRUE[4], 25), (TRUE[11], 44)):
        whole = message()
        for end in range(len(whole)):
            assert holds(source, whole[:end]) is (end >= field_end)


def test_invalid_utf8_denies() -> None:
    data = message(frame="ab").replace(b"ab", b"\xff\xfe")
    assert not holds("msg.frame != 'x'", data)
    assert not holds("msg.frame != 'x'", memoryview(data))
    assert holds("msg.count < 0", memoryview(data))


REFUSED = {
    "": "unexpected 'the end'",
    "1": "must be true or false, this is a int",
    "msg.frame": "this is a string",
    "now": "this is a timestamp",
    "1 +": "unexpected 'the end' at character 4",
    "(true": "unexpected",
    "true)": "unexpected",
    "true true": "unexpected",
    "1 < 2 < 3": "unexpected '<'",
    "1 == 1 == true": "unexpected '=='",
    "true ? 1 : 2": "cannot read",
    "1 / 2 == 0": "cannot read",
    "true; true": "cannot read",
    "__import__('os')": "unknown function __import__",
    "exec": "unknown name 'exec'",
    "msg.on.__class__": "has no fields",
    "msg.frame.upper() == 'A'": "a string has no method upper",
    "msg.frame.contains(1)": "no method contains",
    "msg.frame.contains()": "no method contains",
    "msg.count.contains('a')": "a int has no method contains",
    "now.getHour() == 1": "a timestamp has no method getHour",
    "now.getHours(1) == 1": "a time zone must be text",
    "now.getHours('UTC', 'UTC') == 1": "a time zone must be text",
    "now.getHours('Mars/Base') == 1": "unknown time zone 'Mars/Base'",
    "now.getHours('../../etc/passwd') == 1": "unknown time zone",
    "now.getHours('') == 1": "unknown time zone",
    "now.secs == 1": "only msg has fields",
    "now == 1800000000": "== cannot be applied to timestamp and int",
    "now + 1 == now": ". cannot be applied to timestamp and int",
    "now < timestamp('tomorrow')": "not a time",
    "now < timestamp('2027-13-15T08:00:00Z')": "not a time",
    "now < timestamp('2027-01-15T08:00:00')": "not a time",
    "now < timestamp(1)": "unknown function timestamp",
    "msg == msg": "is a t/T",
    "msg.positon > 1": "msg.positon: no field 'positon' in t/T .has on, skipped",
    "msg.inner.nam == 'a'": "msg.inner.nam: no field 'nam' in t/N",
    "msg.inner == 1": "msg.inner is a t/N",
    "msg.stamp == 1": "msg.stamp is a time",
    "msg.values == 1": "msg.values is a float64",
    "msg.values[0] == 1": "unexpected",
    "msg.skipped.name == 'a'": "has no fields",
    "msg.frame == 1": "== cannot be applied to string and int",
    "msg.on == 1": "== cannot be applied to bool and int",
    "msg.on && 1": "&& cannot be applied to bool and int",
    "!1": "! cannot be applied to a int",
    "-true == true": "- cannot be applied to a bool",
    "-'a' == 'a'": "- cannot be applied to a string",
    "1 + 1.0 == 2.0": "cannot be applied to int and double",
    "'a' + 'b' == 'ab'": "cannot be applied to string and string",
    "1 in ['a']": "in cannot compare int with string",
    "1 in 1": "unexpected '1'",
    "[1] == [1]": "unexpected",
    "1 in [[1]]": "unexpected",
    "1 in [1": "unexpected",
    "1 in [1 2]": "unexpected",
    "1a == 1": "cannot read a number",
    "01x == 1": "cannot read a number",
    "1.0.0 == 1.0": "unexpected",
    "9223372036854775808 > 0": "beyond 64 bits",
    "'a": "cannot read",
    "'\\q' == 'q'": "unknown escape",
    "'\\ud800' == 'q'": "unknown escape",
    "'a\nb' == 'q'": "cannot read",
    "timestamp": "unknown name",
    "now.getHours": "only msg has fields",
    "msg. == 1": "unexpected",
}


@pytest.mark.parametrize("source", REFUSED)
def test_an_invalid_condition_is_refused(source: str) -> None:
    with pytest.raises(ConditionRefused, match=REFUSED[source]):
        compile_condition(SHAPE, source)


def test_length_nodes_and_depth_are_limited() -> None:
    for source, refusal in (
        ("true" + " " * 1000, "more than 1000 characters"),
        (" && ".join(["true"] * 40), "more than 64 parts"),
        ("(" * 200 + "true" + ")" * 200, "deeper than 32"),
        ("!" * 100 + "true", "more than 64 parts"),
        ("1 in [" + ",".join("1" * 80) + "]", "more than 64 parts"),
    ):
        with pytest.raises(ConditionRefused, match=refusal):
            check_syntax(source)
    assert holds("(" * 20 + "true" + ")" * 20)
    assert holds(" && ".join(["true"] * 32))


def test_conditions_without_a_message() -> None:
    condition = compile_condition(None, "now.getHours() >= 8")
    assert condition(b"", NOW)
    assert not condition(b"", NOW - 1)
    with pytest.raises(ConditionRefused, match="needs a message type"):
        compile_condition(None, "msg.on")


def test_a_time_out_of_range_denies() -> None:
    assert not compile_condition(None, "now.getHours() >= 0")(b"", 1 << 60)


def test_syntax_is_checked_without_a_type() -> None:
    check_syntax("msg.any.field > 1")
    with pytest.raises(ConditionRefused):
        check_syntax("msg.any.field >")


def test_field_names_never_appear_in_the_source() -> None:
    shape = layout("bool lambda")
    assert compile_condition(shape, "msg.lambda")(b"\1", NOW)


def test_random_texts_are_compiled_or_refused() -> None:
    rng = seeded_random(7)
    words = "msg.on msg.x msg.count now timestamp ( ) [ , ! - * && || == < in 'a' 1 2.5 true false"
    done: list[Any] = []
    for _ in range(3000):
        source = " ".join(rng.choices(words.split(), k=rng.randrange(1, 12)))
        try:
            done.append(compile_condition(SHAPE, source)(message(), NOW))
        except ConditionRefused:
            continue
    assert set(done) == {True, False}


def test_conditions_on_a_layout_with_all_types() -> None:
    compile_condition(LAYOUT, "msg.header.seq == 1 && msg.f64 > 0.0 && msg.text == ''")

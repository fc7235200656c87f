"""Filters on serialized messages: equal to deserialize, modify, serialize."""

import importlib
import math
from contextlib import suppress
from functools import cache
from typing import Any

import pytest

from grants.errors import FilterRefused, MessageRefused
from grants.filters.compile import compile_filter
from grants.filters.layout import parse
from grants.model import FilterRule, filter_rules
from tests.grants.filters.test_layout import ros_types
from tests.grants.messages import LAYOUT, SEPARATOR, fill, layout, seeded_random, serialized, text

Rules = dict[str, dict[str, object]]
CLEAR: dict[str, object] = {"clear": True}


def rounded(step: float) -> dict[str, object]:
    return {"round": {"step": step}}


# --- reference: the same on deserialized messages ---


def zero(kind: str) -> Any:
    genmsg, roslib, genpy = map(importlib.import_module, ("genmsg.msgs", "roslib.message", "genpy"))
    base, is_array, length = genmsg.parse_type(kind)
    if is_array and length is None:
        return []
    if is_array:
        one = zero(base)
        return bytes(length) if base in ("uint8", "char") else [one] * length
    special = {"time": genpy.Time(), "duration": genpy.Duration(), "string": "", "bool": False}
    if base in special:
        return special[base]
    return 0 if genmsg.is_builtin(base) else roslib.get_message_class(base)()


def round_value(kind: str, value: Any, step: float) -> Any:
    genmsg, genpy = map(importlib.import_module, ("genmsg.msgs", "genpy"))
    base, is_array, _ = genmsg.parse_type(kind)
    if is_array:
        values = [round_value(base, item, step) for item in value]
        return bytes(values) if base in ("uint8", "char") else values
    if not genmsg.is_builtin(base):
        for name, inner in zip(value.__slots__, value._slot_types, strict=True):
            setattr(value, name, round_value(inner, getattr(value, name), step))
        return value
    if base in ("time", "duration"):
        ticks, unit = round(step * 1e9), 10**9
        low, high = (0, 2**32 - 1) if base == "time" else (-(2**31), 2**31 - 1)
        total = suggest(value.secs * unit + value.nsecs, ticks, low * unit, high * unit + unit - 1)
        return type(value)(*divmod(total, unit)) if base == "time" else genpy.Duration(*divmod(total, unit))
    if base.startswith("float"):
        if not math.isfinite(value) or not math.isfinite(value / step):
            return value
        return math.floor(value / step + 0.5) * step
    size = {"char": 8, "byte": 8}.get(base) or int(base.lstrip("uint"))
    unsigned = base.startswith("u") or base == "char"
    low, high = (0, 2**size - 1) if unsigned else (-(2 ** (size - 1)), 2 ** (size - 1) - 1)
    return suggest(value, int(step), low, high)


def suggest(value: int, step: int, low: int, high: int) -> int:
    found = (2 * value + step) // (2 * step) * step
    while found > high:
        found -= step
    while found < low:
        found += step
    return found


def treat(message: Any, path: str, step: float | None) -> None:
    head, _, rest = path.partition(".")
    name = head.removesuffix("[*]")
    if rest:
        inner = getattr(message, name)
        for item in inner if head.endswith("[*]") else [inner]:
            treat(item, rest, step)
        return
    kind = message._slot_types[message.__slots__.index(name)]
    value = zero(kind) if step is None else round_value(kind, getattr(message, name), step)
    setattr(message, name, value)


def compare(kind: Any, rules: Rules, runs: int) -> None:
    compiled = compile_filter(parse(kind._type, kind._full_text), filter_rules(rules))
    rng = seeded_random(len(rules) + len(kind._type))
    for _ in range(runs):
        data = serialized(fill(kind(), rng))
        expected = kind().deserialize(data)
        for path, treatment in rules.items():
            step: Any = treatment.get("round")
            treat(expected, path, None if step is None else step["step"])
        assert b"".join(compiled(data)) == serialized(expected), (kind._type, rules)


CASES: list[tuple[str, Rules]] = [
    ("geometry_msgs/PoseStamped", {"pose.position": rounded(0.5), "header.frame_id": CLEAR}),
    ("geometry_msgs/PoseStamped", {"pose": rounded(0.1), "header.stamp": rounded(60)}),
    ("geometry_msgs/PoseStamped", {"header": CLEAR, "pose.orientation": CLEAR}),
    ("geometry_msgs/PoseStamped", {"header.seq": rounded(7), "pose.orientation.w": rounded(1)}),
    ("sensor_msgs/LaserScan", {"ranges": rounded(0.1)}),
    ("sensor_msgs/LaserScan", {"ranges": rounded(0.25), "intensities": CLEAR, "angle_min": CLEAR}),
    ("sensor_msgs/Image", {"header.frame_id": CLEAR}),
    ("sensor_msgs/Image", {"data": rounded(16), "encoding": CLEAR}),
    ("sensor_msgs/Image", {"data": CLEAR, "width": CLEAR, "height": CLEAR}),
    ("nav_msgs/Odometry", {"pose.pose.position": rounded(0.5), "twist": CLEAR}),
    ("nav_msgs/Odometry", {"pose.covariance": rounded(0.5), "child_frame_id": CLEAR}),
    ("nav_msgs/Path", {"poses[*].pose.position": rounded(0.5)}),
    ("nav_msgs/Path", {"poses[*].header.frame_id": CLEAR, "poses[*].header.seq": CLEAR}),
    ("geometry_msgs/PoseArray", {"poses[*].position": rounded(0.5)}),
    ("geometry_msgs/PoseArray", {"poses[*].position.x": CLEAR, "poses[*].orientation": rounded(1)}),
    ("sensor_msgs/PointCloud", {"points": rounded(0.5), "channels[*].values": rounded(2)}),
    ("sensor_msgs/PointCloud", {"channels[*].name": CLEAR}),
    ("sensor_msgs/JointState", {"position": rounded(0.5), "name": CLEAR}),
    ("sensor_msgs/MultiDOFJointState", {"wrench[*].force": rounded(2), "twist": CLEAR}),
    ("actionlib_msgs/GoalStatusArray", {"status_list[*].goal_id.stamp": rounded(1)}),
    ("rosgraph_msgs/TopicStatistics", {"period_mean": rounded(0.5), "window_start": CLEAR}),
]


@pytest.mark.ros
@pytest.mark.parametrize("number", range(len(CASES)))
def test_random_rules_equal_genpy(number: int) -> None:
    name, rules = CASES[number]
    kind = importlib.import_module("roslib.message").get_message_class(name)
    compare(kind, rules, 60)


@pytest.mark.ros
def test_every_field_of_every_type_equals_genpy() -> None:
    done = 0
    for kind in ros_types():
        for name in kind.__slots__:
            compare(kind, {name: CLEAR}, 3)
            with suppress(FilterRefused):  # not made of numbers only
                compare(kind, {name: rounded(3)}, 3)
            done += 1
    assert done > 200


# --- without ROS ---


@cache
def sample() -> bytes:
    """A message of LAYOUT; the filters under test read it."""
    numbers = b"\1\xfe" + bytes(range(16)) + bytes(4) + bytes(8)
    points = [bytes(range(24 * n, 24 * n + 24)) for n in range(3)]
    path = (3).to_bytes(4, "little") + b"".join(points)
    named = text("näme") + path + points[1]
    return b"".join(
        [
            bytes(12),
            text("map"),
            numbers,
            bytes(range(16)),
            text("hällo"),
            points[0],
            path,
            points[1] * 2,
            (2).to_bytes(4, "little") + bytes(range(8)),
            bytes(24),
            bytes(288),
            (10).to_bytes(4, "little") + bytes(range(10)),
            (1).to_bytes(4, "little") + bytes(range(8)),
            bytes(4),
            (2).to_bytes(4, "little") + text("a") + text("bc"),
            (2).to_bytes(4, "little") + named * 2,
            named * 2,
        ]
    )


def apply(rules: Rules, message: bytes | memoryview | bytearray | None = None) -> bytes:
    compiled = compile_filter(LAYOUT, filter_rules(rules))
    return b"".join(compiled(sample() if message is None else message))


ALL_RULES: list[Rules] = [
    {},
    {"header": CLEAR},
    {"i8": rounded(2), "u64": CLEAR, "f32": rounded(0.5), "stamp": rounded(1), "text": CLEAR},
    {"point": rounded(1), "points": rounded(1), "corners": rounded(1), "ranges": rounded(1)},
    {"three": rounded(1), "covariance": rounded(1), "longs": rounded(2), "times": rounded(2)},
    {"names": CLEAR, "named": CLEAR, "pair": CLEAR},
    {"named[*].name": CLEAR, "named[*].path[*].y": CLEAR, "pair[*].path": rounded(1)},
    {"data": {"truncate": {"length": 3}}, "text": {"truncate": {"length": 2}}, "longs": CLEAR},
    {"ranges": {"zero": True}, "covariance": {"zero": True}, "points": {"drop": True}},
]


@pytest.mark.parametrize("number", range(len(ALL_RULES)))
def test_truncated_and_extended_messages_are_refused(number: int) -> None:
    compiled = compile_filter(LAYOUT, filter_rules(ALL_RULES[number]))
    whole = sample()
    compiled(whole)
    for end in range(len(whole)):
        with pytest.raises(MessageRefused, match="not a test_msgs/Everything"):
            compiled(whole[:end])
    for tail in (b"\0", bytes(100)):
        with pytest.raises(MessageRefused):
            compiled(whole + tail)


@pytest.mark.parametrize("number", range(len(ALL_RULES)))
def test_mutated_messages_are_filtered_or_refused(number: int) -> None:
    compiled = compile_filter(LAYOUT, filter_rules(ALL_RULES[number]))
    rng = seeded_random(number)
    for _ in range(1500):
        mutated = bytearray(sample())
        for _ in range(rng.randrange(1, 5)):
            mutated[rng.randrange(len(mutated))] = rng.choice([0, 1, 127, 128, 255])
        with suppress(MessageRefused):
            compiled(bytes(mutated))


def test_a_filter_without_rules_changes_nothing() -> None:
    assert apply({}) == sample()


def test_filtering_twice_changes_nothing_more() -> None:
    for rules in ALL_RULES:
        once = apply(rules)
        assert apply(rules, once) == once


@pytest.mark.parametrize("kind", [bytes, bytearray, memoryview])
def test_a_message_may_be_any_buffer(kind: Any) -> None:
    rules = ALL_RULES[6]
    assert apply(rules, kind(sample())) == apply(rules)


def test_a_large_message_is_not_copied() -> None:
    image = layout("string name\nuint8[] data\nstring encoding")
    message = text("camera") + (1 << 20).to_bytes(4, "little") + bytes(1 << 20) + text("rgb8")
    pieces = compile_filter(image, filter_rules({"name": CLEAR}))(message)
    assert len(pieces) <= 3
    assert sum(len(piece) for piece in pieces if not isinstance(piece, memoryview)) < 100
    assert all(piece.obj is message for piece in pieces if isinstance(piece, memoryview))
    assert b"".join(pieces) == bytes(4) + message[10:]


def test_many_pieces_are_joined() -> None:
    names = layout("N[] n", "MSG: t/N\nstring s\nint32 i")
    message = (99).to_bytes(4, "little") + (text("a") + b"1234") * 99
    pieces = compile_filter(names, filter_rules({"n[*].s": CLEAR}))(message)
    assert pieces == [(99).to_bytes(4, "little") + (bytes(4) + b"1234") * 99]


def test_counts_beyond_the_message_are_refused_fast() -> None:
    huge = (2**32 - 1).to_bytes(4, "little")
    for fields in ("int32[] a", "N[] a", "E[] a", "float64[] a"):
        sections = ("MSG: t/N\nstring s", "MSG: t/E")
        shape = layout(fields + "\nuint8 end", *sections)
        for rules in ({"a": CLEAR}, {"end": CLEAR}):
            with suppress(MessageRefused):
                pieces = compile_filter(shape, filter_rules(rules))(huge + b"\0")
                assert fields.startswith("E")  # elements without bytes
                assert len(b"".join(pieces)) <= 5


REFUSED: list[tuple[str, str, dict[str, object], str]] = [
    ("misspelt", "positon", CLEAR, "positon: no field 'positon' in test_msgs/Everything"),
    ("misspelt inside", "point.w", CLEAR, "point.w: no field 'w' in test_msgs/Point .has x, y, z"),
    ("misspelt element", "named[*].nam", CLEAR, r"named\[\*\].nam: no field 'nam'"),
    ("into a number", "i8.x", CLEAR, "i8 is a int8 and has no fields"),
    ("into an array", "points.x", CLEAR, r"points is a test_msgs/Point\[\] and has no fields"),
    ("elements of a struct", "point[*].x", CLEAR, "not an array of messages"),
    ("elements of numbers", "ranges[*].x", CLEAR, "not an array of messages"),
    ("star at the end", "points[*]", CLEAR, "must be followed by a field"),
    ("round a text", "text", rounded(1), "text: round needs numbers, not string"),
    ("round a text inside", "header", rounded(1), "header.frame_id: round needs numbers"),
    ("round a bool", "flag", rounded(1), "flag: round needs numbers, not bool"),
    ("operator", "i8", {"blur": True}, "i8: unknown operator 'blur'"),
]


@pytest.mark.parametrize(("name", "path", "treatment", "message"), REFUSED)
def test_refused_rules(name: str, path: str, treatment: dict[str, object], message: str) -> None:
    with pytest.raises(FilterRefused, match=message):
        apply({path: treatment})


@pytest.mark.parametrize(
    "paths", [("point", "point.x"), ("points", "points[*].x"), ("named[*].path", "named[*].path[*].x")]
)
def test_overlapping_rules_are_refused(paths: tuple[str, str]) -> None:
    for order in (paths, paths[::-1]):
        with pytest.raises(FilterRefused, match="has a filter, or contains one"):
            compile_filter(LAYOUT, [FilterRule(path, "clear") for path in order])


def test_two_rules_for_one_field_are_refused() -> None:
    with pytest.raises(FilterRefused, match="or contains one"):
        compile_filter(LAYOUT, [FilterRule("i8", "clear"), FilterRule("i8", "clear")])


def test_a_type_without_treatment_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    operators = importlib.import_module("grants.filters.operators")
    monkeypatch.setitem(operators.OPERATORS, "shrug", lambda *_: lambda _: operators.DESCEND)
    with pytest.raises(FilterRefused, match="i8: no treatment for int8"):
        apply({"i8": {"shrug": True}})


NOTHINGS = "Nothing[] many\nPair[] pairs\nNothing one\nstring text\n" + "\n".join(
    [
        SEPARATOR,
        "MSG: t/Nothing",
        SEPARATOR,
        "MSG: t/Pair",
        "Nothing[] inner",
        "Nothing single",
        "Nothing[3] fixed",
        SEPARATOR,
    ]
).removesuffix("\n" + SEPARATOR)


@pytest.mark.parametrize(
    "rules",
    [
        {"many": {"zero": True}},
        {"many": {"round": {"step": 1}}},
        {"pairs[*].inner": {"zero": True}},
        {"pairs[*].inner": {"clamp": {"low": 0, "high": 1}}, "pairs[*].single": CLEAR},
        {"pairs[*].fixed": CLEAR, "one": CLEAR},
        {"pairs": {"round": {"step": 1}}, "many": {"round": {"step": 2}}, "text": CLEAR},
    ],
)
def test_elements_without_bytes_are_counted_and_passed(rules: Rules) -> None:
    kind = parse("t/Nothings", NOTHINGS)
    nine = bytes([9, 0, 0, 0])
    for count in (b"\0\0\0\0", nine):
        message = count + bytes([2, 0, 0, 0]) + 2 * count + text("t" if "text" not in rules else "")
        assert b"".join(compile_filter(kind, filter_rules(rules))(message)) == message


@pytest.mark.parametrize("operator", ["truncate", "sort"])
def test_the_refusal_of_elements_without_bytes_names_what_is_needed(operator: str) -> None:
    treatment = {"truncate": {"length": 1}, "sort": True}[operator]
    with pytest.raises(FilterRefused, match="elements have"):
        compile_filter(parse("t/Nothings", NOTHINGS), filter_rules({"many": {operator: treatment}}))

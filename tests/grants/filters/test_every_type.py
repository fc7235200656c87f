"""Every message type of Debian's message packages: random filters equal genpy, byte for byte."""

import hashlib
import hmac
import importlib
import math
import random  # noqa: TID251 - seeded, for reproducible failures
from collections.abc import Callable, Iterator
from typing import Any

import pytest

from grants.filters import message_rewriter
from grants.filters.compile import compile_filter
from grants.filters.layout import parse
from grants.filters.operators import OPERATORS
from grants.model import filter_rules
from tests.grants.filters.test_compile import round_value, zero
from tests.grants.messages import fill, seeded_random, serialized

pytestmark = pytest.mark.ros

PACKAGES = (
    "std_msgs",
    "sensor_msgs",
    "geometry_msgs",
    "nav_msgs",
    "diagnostic_msgs",
    "stereo_msgs",
    "shape_msgs",
    "trajectory_msgs",
    "visualization_msgs",
    "actionlib_msgs",
    "actionlib",
    "tf2_msgs",
)
AT_LEAST = 101
KEYS = {"ward": bytes(range(32))}
RUNS = 10  # sets of rules per type
MESSAGES = 5  # per set of rules

Rules = dict[str, dict[str, object]]


def debian_types() -> dict[str, Any]:
    """All message classes of the packages, by type name."""
    kinds = [
        kind
        for package in PACKAGES
        for kind in vars(importlib.import_module(f"{package}.msg")).values()
        if hasattr(kind, "_full_text")
    ]
    return {kind._type: kind for kind in kinds if kind._type.split("/")[0] in PACKAGES}


def fields(kind: Any, above: str = "", inside: bool = False) -> Iterator[tuple[str, str, bool]]:
    """Path, type and whether it lies in an array, of every field and subfield."""
    genmsg, roslib = map(importlib.import_module, ("genmsg.msgs", "roslib.message"))
    for name, declared in zip(kind.__slots__, kind._slot_types, strict=True):
        yield above + name, declared, inside
        base, is_array, _ = genmsg.parse_type(declared)
        if not genmsg.is_builtin(base):
            step = f"{above}{name}[*]." if is_array else f"{above}{name}."
            yield from fields(roslib.get_message_class(base), step, inside or is_array)


# --- reference: each operator on values of genpy ---


def elements(declared: str, value: Any, change: Callable[[Any], Any]) -> Any:
    genmsg = importlib.import_module("genmsg.msgs")
    base, is_array, _ = genmsg.parse_type(declared)
    if not is_array:
        return change(value)
    changed = [change(item) for item in value]
    return bytes(changed) if base in ("uint8", "char") else changed


def clamped(value: float, low: float, high: float) -> float:
    return low if not value >= low else min(value, high)


def pseudonym(value: str) -> str:
    return hmac.new(KEYS["ward"], value.encode(), hashlib.sha256).hexdigest()[:12]


def held(memory: dict[str, float], path: str, value: float, step: float, beyond: float) -> float:
    if path in memory and abs(value - memory[path]) <= step / 2 + beyond:
        return memory[path]
    rounded = round_value("float64", value, step)
    if math.isfinite(rounded):
        memory[path] = rounded
    return float(rounded)


Change = Callable[[str, Any], Any]


def choices(
    path: str, declared: str, inside: bool, memory: dict[str, float]
) -> list[tuple[dict[str, object], Change]]:
    """The operators that can treat a field of this type, each with its reference."""
    genmsg = importlib.import_module("genmsg.msgs")
    base, is_array, length = genmsg.parse_type(declared)
    found: list[tuple[dict[str, object], Change]] = [({"clear": True}, lambda kind, _: zero(kind))]
    if is_array and length is None:
        found.append(({"drop": True}, lambda kind, _: zero(kind)))
    fixed = genmsg.is_builtin(base) and base != "string"
    if is_array and fixed:

        def zeros(kind: str, value: Any) -> Any:
            return elements(kind, value, lambda _: zero(base))

        found.append(({"zero": True}, zeros))
        if length is None:
            found.append(({"truncate": {"length": 2}}, lambda _, value: value[:2]))
    if base == "string":
        found += text_choices(is_array)
    if fixed and base != "bool":
        found.append(({"round": {"step": 3}}, lambda kind, value: round_value(kind, value, 3)))
    if fixed and base not in ("bool", "time", "duration"):
        found.append(
            (
                {"clamp": {"low": 5, "high": 50}},
                lambda k, v: elements(k, v, lambda item: clamped(item, 5, 50)),
            )
        )
        if not is_array:
            found.append(({"set": {"value": 7}}, lambda *_: 7))
    if base == "float64" and not is_array and not inside:
        rule: dict[str, object] = {"round": {"step": 50.0, "hysteresis": 20.0}}
        found.append((rule, lambda _, value: held(memory, path, value, 50.0, 20.0)))
    return found


def text_choices(is_array: bool) -> list[tuple[dict[str, object], Change]]:
    hashed: dict[str, object] = {"hash": {"key": "ward", "length": 12}}
    if is_array:
        return [(hashed, lambda kind, value: elements(kind, value, pseudonym))]
    return [
        (hashed, lambda _, value: pseudonym(value)),
        ({"redact": {"text": "x ß"}}, lambda *_: "x ß"),
        ({"set": {"value": "ß"}}, lambda *_: "ß"),
        ({"truncate": {"length": 2}}, lambda _, value: value[:2]),
    ]


def treat(message: Any, path: str, change: Change) -> None:
    head, _, rest = path.partition(".")
    name = head.removesuffix("[*]")
    if rest:
        inner = getattr(message, name)
        for item in inner if head.endswith("[*]") else [inner]:
            treat(item, rest, change)
        return
    declared = message._slot_types[message.__slots__.index(name)]
    setattr(message, name, change(declared, getattr(message, name)))


def overlaps(path: str, others: Rules) -> bool:
    steps = path.replace("[*]", "").split(".")
    for other in others:
        more = other.replace("[*]", "").split(".")
        if steps[: len(more)] == more or more[: len(steps)] == steps:
            return True
    return False


def random_rules(kind: Any, rng: random.Random, memory: dict[str, float]) -> tuple[Rules, dict[str, Change]]:
    rules: Rules = {}
    changes: dict[str, Change] = {}
    found = list(fields(kind))
    for path, declared, inside in rng.sample(found, len(found)):
        if len(rules) < 5 and not overlaps(path, rules):
            rule, change = rng.choice(choices(path, declared, inside, memory))
            rules[path], changes[path] = rule, change
    return rules, changes


def compare(kind: Any, rng: random.Random) -> None:
    """Random rules over random messages."""
    memory: dict[str, float] = {}
    rules, changes = random_rules(kind, rng, memory)
    shape = parse(kind._type, kind._full_text)
    compiled = compile_filter(shape, filter_rules(rules), KEYS)
    for _ in range(MESSAGES):
        data = serialized(fill(kind(), rng))
        expected = kind().deserialize(data)
        for path, change in changes.items():
            treat(expected, path, change)
        assert b"".join(compiled(data)) == serialized(expected), (kind._type, rules)


def test_checksums_equal_genpy() -> None:
    kinds = debian_types()
    assert len(kinds) >= AT_LEAST, f"only {len(kinds)} types: see tools/ros-packages.sh"
    for name, kind in kinds.items():
        assert parse(name, kind._full_text).md5 == kind._md5sum, name


@pytest.mark.parametrize("package", PACKAGES)
@pytest.mark.parametrize("minimum", [0, 24])
def test_random_filters_equal_genpy(package: str, minimum: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Arrays of elements of different sizes are treated in both ways: collected, and one by one."""
    monkeypatch.setattr(message_rewriter, "MIN_COLLECTED", minimum)
    kinds = {name: kind for name, kind in debian_types().items() if name.startswith(f"{package}/")}
    assert kinds
    for name, kind in kinds.items():
        rng = seeded_random(sum(name.encode()) + minimum)
        for _ in range(RUNS):
            compare(kind, rng)


def test_every_operator_is_chosen() -> None:
    offered = {
        operator
        for kind in debian_types().values()
        for path, declared, inside in fields(kind)
        for rule, _ in choices(path, declared, inside, {})
        for operator in rule
    }
    assert offered | {"pixelate", "rooms", "sort"} == OPERATORS.keys()  # tests of their own

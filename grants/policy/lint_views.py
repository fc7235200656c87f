"""What each receiver of a policy sees: every topic, with all that holds for it together.

A receiver is one sample node for each subject of the policy, once for each key that is pinned for such a
node; what a person may still approve counts as seen. What a field shows (`Aspect`) is said by
`grants.vocabulary`; where that knows nothing of a number, by its name, and where a topic has no type, by the
topic's.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from functools import cached_property
from typing import Final

from ca.names import pattern_covers
from grants.filters.layout import Array, Layout, Primitive
from grants.model import FilterRule, Right
from grants.policy.decision import Decider, Verdict
from grants.policy.model import Clause, Effect, Policy, PolicyRule, Subject, SubjectPattern
from grants.policy.names import includes, is_own
from grants.policy.privacy import leaf_paths
from grants.vocabulary.assess import filters_of
from grants.vocabulary.contents import Content, Description, FieldContent


class Aspect(StrEnum):
    POSITION = "position"
    HEADING = "orientation"
    MOVEMENT = "movement"
    COVARIANCE = "covariance"
    TIME = "time"
    COUNT = "count"
    SURROUNDINGS = "surroundings"
    IMAGE = "image"
    NAME = "name"
    JOINT = "joints"
    JOINT_RATE = "movement of joints"
    STATE = "state"  # of a battery, a goal, an air: it changes with where that is
    WARMTH = "temperature"
    HUMIDITY = "humidity"
    LIGHT = "brightness"
    PLAN = "map"
    SOUND = "sound"
    MARK = "mark"
    NOTHING = "nothing"


_OF: Final[Mapping[Content, Aspect]] = {
    **dict.fromkeys((Content.COORDINATE, Content.DEGREES, Content.HEIGHT), Aspect.POSITION),
    Content.HEADING: Aspect.HEADING,
    **dict.fromkeys((Content.VELOCITY, Content.CONTROL, Content.FORCE), Aspect.MOVEMENT),
    Content.UNCERTAINTY: Aspect.COVARIANCE,
    Content.TIME: Aspect.TIME,
    Content.COUNT: Aspect.COUNT,
    **dict.fromkeys((Content.DISTANCE, Content.MAP), Aspect.SURROUNDINGS),
    **dict.fromkeys((Content.PICTURE, Content.COMPRESSED_PICTURE), Aspect.IMAGE),
    **dict.fromkeys((Content.NAME, Content.REQUEST), Aspect.NAME),
    **dict.fromkeys((Content.MARK, Content.WEAR), Aspect.MARK),
    Content.SAMPLES: Aspect.SOUND,
    **dict.fromkeys((Content.STATE, Content.CHARGE, Content.PRESSURE), Aspect.STATE),
    **dict.fromkeys((Content.TEMPERATURE, Content.AMBIENT_TEMPERATURE), Aspect.WARMTH),
    **dict.fromkeys((Content.HUMIDITY, Content.AMBIENT_HUMIDITY), Aspect.HUMIDITY),
    **dict.fromkeys((Content.BRIGHTNESS, Content.AMBIENT_BRIGHTNESS), Aspect.LIGHT),
    Content.JOINT: Aspect.JOINT,
}
# Beside the values these have sizes and states, which alone show little.
_NUMBERS_ONLY: Final = frozenset({Content.UNCERTAINTY, Content.DISTANCE, Content.MAP})
# Of a sensor that may be carried about, so the room follows from it.
AMBIENT: Final = (Content.AMBIENT_TEMPERATURE, Content.AMBIENT_HUMIDITY, Content.AMBIENT_BRIGHTNESS)
# Types in whose points a person is recognised as in a picture; the names of their topics.
DEPTH: Final = frozenset({"sensor_msgs/PointCloud", "sensor_msgs/PointCloud2", "stereo_msgs/DisparityImage"})
CLOUDS: Final = ("points", "pointcloud")
_STEADY: Final = ("diagnostic_msgs/", "tf2_msgs/")  # their states hardly tell where something is
_RATES: Final = ("velocity", "velocities", "accelerations", "effort")
_NAMED: Final[Mapping[str, Aspect]] = {
    **dict.fromkeys(("x", "y", "latitude", "longitude", "lat", "lon", "lng"), Aspect.POSITION),
    **dict.fromkeys(("theta", "yaw", "heading"), Aspect.HEADING),
    **dict.fromkeys(
        ("vx", "vy", "speed", "velocity", "linear_velocity", "angular_velocity"), Aspect.MOVEMENT
    ),
}
_CONVENTIONS: Final[Mapping[str, Aspect]] = {
    **dict.fromkeys(("tf", "odom", "amcl_pose", "pose", "plan", "path", "fix"), Aspect.POSITION),
    **dict.fromkeys(("cmd_vel", "imu"), Aspect.MOVEMENT),
    **dict.fromkeys(("mag", "compass", "magnetic_field"), Aspect.HEADING),
    **dict.fromkeys(("battery", "battery_state", "barometer", "fluid_pressure"), Aspect.STATE),
    **dict.fromkeys(("audio", "microphone", "mic"), Aspect.SOUND),
    "joint_states": Aspect.JOINT,
    **dict.fromkeys(("scan", *CLOUDS), Aspect.SURROUNDINGS),
    **dict.fromkeys(("camera", "image", "image_raw", "image_color", "compressed"), Aspect.IMAGE),
    **dict.fromkeys(("clock", "rosout", "rosout_agg", "map", "camera_info", "tf_static"), Aspect.NOTHING),
}
# Topics of most robots, which a pattern may cover though no line names them.
EVERYWHERE: Final = ("/tf", "/odom", "/amcl_pose", "/scan", "/cmd_vel", "/camera/image_raw", "/fix")


def aspects(described: Description, topic: str = "") -> dict[str, Aspect]:
    found = {field.path: _aspect(field, described, topic) for field in described.fields}
    return {path: aspect for path, aspect in found.items() if aspect is not Aspect.NOTHING}


def is_known(described: Description) -> bool:
    if all(field.content is not Content.UNKNOWN for field in described.fields):
        return True
    return any(_by_name(field) is not Aspect.NOTHING for field in described.fields)


def conventional(topic: str) -> Aspect | None:
    """What a topic whose type is not given shows by its name; None if that says nothing."""
    named = [segment for segment in topic.split("/") if "*" not in segment]
    return _CONVENTIONS.get(named[-1])  # the first is empty


def _aspect(field: FieldContent, described: Description, topic: str) -> Aspect:
    if field.content is Content.UNKNOWN:
        return _by_name(field)
    is_value = isinstance(field.kind, Array) or (
        isinstance(field.kind, Primitive) and field.kind.code in "fd"
    )
    steady = field.content is Content.STATE and described.type_name.startswith(_STEADY)
    if steady or (field.content in _NUMBERS_ONLY and not is_value):
        return Aspect.NOTHING
    if field.content is Content.MAP and "local" not in topic:
        return Aspect.PLAN  # the map of a house is not where the robot is
    if field.content is Content.UNCERTAINTY:
        above = field.path.rpartition(".")[0]
        velocities = (one.path for one in described.fields if one.content is Content.VELOCITY)
        if any(path.startswith(above) for path in velocities):
            return Aspect.MOVEMENT  # to be cleared with it, as one message
        # A policy may say of its own type that another field tells a position.
        return Aspect.COVARIANCE if field.path.endswith("covariance") else Aspect.POSITION
    is_rate = field.content is Content.JOINT and _last(field.path) in _RATES
    return Aspect.JOINT_RATE if is_rate else _OF.get(field.content, Aspect.NOTHING)


def _by_name(field: FieldContent) -> Aspect:
    if field.content is not Content.UNKNOWN or not isinstance(field.kind, Primitive):
        return Aspect.NOTHING
    return _NAMED.get(_last(field.path), Aspect.NOTHING)


def _last(path: str) -> str:
    return path.rpartition(".")[2]


LayoutOf = Callable[[str], Layout]

_HIDES: Final = frozenset({"clear", "set", "redact", "drop", "zero"})
_DEGREES: Final = frozenset({"latitude", "longitude"})
# Squares by which attackers' programs recognise few faces: 96 pixels in squares of 32 are 53 %.
SMALLEST_BLOCK: Final = 32
MOST_ACROSS: Final = 20
_FLOORS: Final[dict[Aspect, float]] = {
    Aspect.POSITION: 0.1,  # metres; localisation indoors errs by half of it
    Aspect.SURROUNDINGS: 0.1,
    Aspect.MOVEMENT: 0.02,  # metres a second
    Aspect.HEADING: 0.02,
    Aspect.JOINT: 0.02,  # radians
    Aspect.JOINT_RATE: 0.02,
    Aspect.TIME: 0.1,  # seconds
}
_DEGREE_FLOOR: Final = 0.0001  # eleven metres, what a receiver in a street errs


class Precision(StrEnum):
    EXACT = "exact"
    COARSE = "coarse"
    HIDDEN = "hidden"


@dataclass(frozen=True)
class LintReceiver:
    subject: Subject
    who: SubjectPattern

    @property
    def label(self) -> str:
        return self.who.group or self.who.label


@dataclass(frozen=True)
class View:
    receiver: LintReceiver
    topic: str
    verdict: Verdict
    layout: Layout | None
    described: Description | None

    @cached_property
    def filters(self) -> tuple[FilterRule, ...]:
        return tuple(rule for item in self.verdict.restrictions for rule in item.filters)

    @cached_property
    def aspects(self) -> dict[str, Aspect]:
        return aspects(self.described, self.topic) if self.described is not None else {}

    @cached_property
    def is_known(self) -> bool:
        if self.described is not None:
            return is_known(self.described)
        return conventional(self.topic) is not None

    def of(self, *wanted: Aspect) -> list[str]:
        return [path for path, aspect in self.aspects.items() if aspect in wanted]

    def left(self, path: str) -> Precision:
        aspect = self.aspects.get(path, Aspect.NOTHING)
        return max(
            (_left_by(rule, aspect, path) for rule in filters_of(self.filters, path)),
            key=list(Precision).index,
            default=Precision.EXACT,
        )

    def exact(self, *wanted: Aspect) -> list[str]:
        return [path for path in self.of(*wanted) if self.left(path) is Precision.EXACT]

    def treated(self, *wanted: Aspect) -> list[str]:
        # The leaves that show one of these coarsely or not at all.
        return [path for path in self.of(*wanted) if self.left(path) is not Precision.EXACT]

    def coarse(self, *wanted: Aspect) -> list[str]:
        return [path for path in self.of(*wanted) if self.left(path) is Precision.COARSE]

    def shows(self, first: Aspect, *others: Aspect) -> bool:
        # Whether one of these is seen exactly, and the first is not treated.
        if self.layout is None:
            return conventional(self.topic) in (first, *others)
        return bool(self.exact(first, *others)) and not self.treated(first)

    @property
    def shows_climate(self) -> bool:
        fields = self.described.fields if self.described is not None else ()
        ambient = (field.path for field in fields if field.content in AMBIENT)
        return any(self.left(path) is Precision.EXACT for path in ambient)

    @property
    def shows_depth(self) -> bool:
        # Whether it shows exactly what a camera of depth sees: points in space, not one plane.
        if self.layout is None:
            return self.topic.rpartition("/")[2] in CLOUDS
        return self.layout.type_name in DEPTH and bool(self.exact(Aspect.SURROUNDINGS))

    @property
    def has_slot(self) -> bool:
        return any(item.slot is not None for item in self.verdict.restrictions)

    @property
    def hides_presence(self) -> bool:
        # Whether its slots are about when messages come, not what is left of their content.
        return self.has_slot and (self.is_empty or not self.filters)

    @cached_property
    def is_empty(self) -> bool:
        if self.layout is None or not self.filters:
            return False
        return all(self.left(path) is Precision.HIDDEN for path in leaf_paths(self.layout))

    @property
    def rule(self) -> PolicyRule:
        return self.place()[0]

    def place(self, of: FilterRule | None = None) -> tuple[PolicyRule, Clause]:
        places = list(zip(self.verdict.rules, self.verdict.clauses, strict=True))
        for rule, clause in places:
            own = clause.restriction.filters if clause.restriction is not None else ()
            if of in own or (of is None and own):
                return rule, clause
        return places[0]

    @property
    def pattern(self) -> str:
        return self.verdict.clauses[0].pattern

    @property
    def is_below_pattern(self) -> bool:
        return all(clause.pattern != self.topic for clause in self.verdict.clauses)

    def filter_on(self, path: str) -> FilterRule:
        return filters_of(self.filters, path)[0]


def _left_by(rule: FilterRule, aspect: Aspect, path: str) -> Precision:
    parameters = dict(rule.parameters)
    if rule.operator in _HIDES or parameters.get("length") == 0:
        return Precision.HIDDEN
    match rule.operator:
        case "clamp" | "truncate" | "sort":  # what is left is as it was
            return Precision.EXACT
        case "pixelate":
            return Precision.EXACT if too_small(rule) else Precision.COARSE
        case "round":
            return Precision.EXACT if too_fine(rule, aspect, path) else Precision.COARSE
        case _:
            return Precision.COARSE


def too_small(rule: FilterRule) -> bool:
    given = dict(rule.parameters)
    block, across = given.get("block"), given.get("across")
    if isinstance(across, int) and across <= MOST_ACROSS:
        return False
    return not isinstance(block, int) or block < SMALLEST_BLOCK


def too_fine(rule: FilterRule, aspect: Aspect, path: str) -> bool:
    step = dict(rule.parameters).get("step")
    degrees = path.rpartition(".")[2] in _DEGREES
    floor = _DEGREE_FLOOR if degrees else _FLOORS.get(aspect, 0.0)
    return isinstance(step, int | float) and step < floor


# Lint judges what a node gets, not what a rule says: two rules that are wise alone may undo each other.
@dataclass(frozen=True)
class LintedPolicy:
    policy: Policy
    layout_of: LayoutOf
    _layouts: dict[str, Layout] = field(default_factory=dict)
    _contents: dict[str, tuple[Layout, Description] | tuple[None, None]] = field(default_factory=dict)

    @cached_property
    def decider(self) -> Decider:
        return Decider(self.policy)

    @cached_property
    def views(self) -> dict[LintReceiver, list[View]]:
        return {receiver: list(self._views(receiver)) for receiver in receivers(self.policy)}

    @property
    def all_views(self) -> Iterator[View]:
        return (view for views in self.views.values() for view in views)

    def contents(self, topic: str) -> tuple[Layout, Description] | tuple[None, None]:
        kind = self.policy.type_of(topic) if topic not in self._contents else None
        if kind is not None:
            if kind not in self._layouts:
                self._layouts[kind] = self.layout_of(kind)
            layout = self._layouts[kind]
            self._contents[topic] = layout, self.policy.vocabulary.describe(layout, topic)
        return self._contents.setdefault(topic, (None, None))

    def _views(self, receiver: LintReceiver) -> Iterator[View]:
        rules = self.decider.rules_of(receiver.subject)
        for topic in _topics(self.policy, rules, receiver.subject):
            verdict = self.decider.decide_by(rules, receiver.subject, Right.SUBSCRIBE, topic)
            if verdict.effect is not Effect.DENY and verdict.rules:
                yield View(receiver, topic, verdict, *self.contents(topic))


def _topics(policy: Policy, rules: Iterable[PolicyRule], subject: Subject) -> list[str]:
    named = {
        found.pattern
        for rule in rules
        if rule.effect is not Effect.DENY
        for clause in rule.clauses
        if clause.right is Right.SUBSCRIBE and (found := clause.of(subject)) is not None
    }
    wide = [pattern for pattern in named if "*" in pattern]
    known = [*policy.types, *EVERYWHERE] if wide else []
    topics = (topic for topic in known if not is_own(topic))
    return sorted(named.union(each for each in topics if any(includes(pattern, each) for pattern in wide)))


def receivers(policy: Policy) -> list[LintReceiver]:
    found: dict[Subject, LintReceiver] = {}
    rules = (rule for rule in policy.rules if rule.effect is not Effect.DENY)
    subjects = list(dict.fromkeys(who for rule in rules for who in rule.who))
    for who in subjects:
        name, keys = who.sample.name, {who.key}
        if who.key is None:
            keys |= {each.key for each in subjects if each.node is None or pattern_covers(each.node, name)}
        for key in keys:
            subject = Subject(name, key or bytes(32))
            found.setdefault(subject, LintReceiver(subject, who))
    return list(found.values())

"""Field filters: from rules and a layout to a function on serialized messages; presets by name.

A message is filtered without being deserialized, so no message classes are needed, and previously unknown
types can be filtered. Every text of a preset is shown to the operator; `python -m bench privacy` attacks
each, `docs/spec/grant.md` lists the attacks.
"""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Final, TypeAlias

from grants.errors import FilterRefused
from grants.filters.coarsening import CommonState, FieldKey, HysteresisState
from grants.filters.hashing import Keys
from grants.filters.layout import Array, Buffer, Layout, Struct, Type
from grants.filters.message_rewriter import generate
from grants.filters.operators import (
    AFTER_OTHERS,
    DESCEND,
    ArrayTreatment,
    FieldTreatment,
    HysteresisBinding,
    Keep,
    Node,
    Numbers,
    SiblingTreatment,
    StructTreatment,
    TreatmentForType,
    has_hysteresis,
    treatment_for,
)
from grants.model import FilterRule, Restriction, filter_rules

# From a message to the filtered one in pieces; kept parts of a large one are views into it. A message that
# does not have the layout is refused.
Filter: TypeAlias = Callable[[Buffer], list[Buffer]]


def compile_filter(
    layout: Layout,
    rules: Iterable[FilterRule],
    keys: Keys | None = None,
    states: Callable[[FieldKey], HysteresisState] | None = None,
) -> Filter:
    """Compile `rules` (see `model.filter_rules`) for messages of `layout`.

    `keys` by name are for `hash`; without them the rules are only checked, and a message to be
    hashed is refused. `states` finds the state of a field with hysteresis; without it, it is new.
    """
    given = tuple(rules)
    last = [rule for rule in given if rule.operator in AFTER_OTHERS]
    find = states or CommonState().hysteresis
    first = _rewriter(layout, [rule for rule in given if rule not in last], keys, find)
    if not last:
        return first
    then = _rewriter(layout, last, keys, find)
    return lambda message: then(b"".join(first(message)))


def _rewriter(
    layout: Layout,
    rules: Iterable[FilterRule],
    keys: Keys | None,
    states: Callable[[FieldKey], HysteresisState],
) -> Filter:
    branch = _Branch({})
    for rule in rules:
        _insert(branch, rule, treatment_for(rule, keys))
    return generate(_bind_hysteresis(_resolve(layout.root, branch, ""), states, ()), layout.type_name)


@dataclass(frozen=True)
class _Branch:
    children: dict[str, "_Branch | TreatmentForType"]


def _insert(branch: _Branch, rule: FilterRule, treat: TreatmentForType) -> None:
    *above, last = rule.path.split(".")
    for step in above:
        below = branch.children.setdefault(step, _Branch({}))
        if not isinstance(below, _Branch):
            raise _overlap(rule.path)
        branch = below
    if last in branch.children:
        raise _overlap(rule.path)
    if last.endswith("[*]"):
        hint = f"{rule.path[:-3]} filters all of the elements"
        raise FilterRefused(f"{rule.path}: [*] must be followed by a field", hint)
    branch.children[last] = treat


def _overlap(path: str) -> FilterRefused:
    return FilterRefused(
        f"{path} is inside a field that has a filter, or contains one",
        "the order would matter: keep one of them",
    )


def _resolve(kind: Struct, branch: _Branch, path: str) -> Node:
    fields = dict(kind.fields)
    for step in branch.children:
        if step.removesuffix("[*]") not in fields:
            raise FilterRefused(f"{path}{step}: {kind.explain_missing(step.removesuffix('[*]'))}")
        if step.endswith("[*]") and step[:-3] in branch.children:
            raise _overlap(path + step)
    parts = [_field(name, member, branch, path) for name, member in kind.fields]
    before: set[tuple[str, str]] = set()
    for (name, member), part in zip(kind.fields, parts, strict=True):
        # A field that needs others of its message: they must precede it and have the right types.
        treatment = part.treatment if isinstance(part, FieldTreatment) else None
        if isinstance(treatment, SiblingTreatment) and (
            kind.name != treatment.message or not before.issuperset(treatment.siblings)
        ):
            raise FilterRefused(
                f"{path}{name} of a {kind.name}: the operator needs the data of a {treatment.message}"
            )
        before.add((name, member.name))
    return _parts(kind, parts)


def _bind_hysteresis(node: Node, states: Callable[[FieldKey], HysteresisState], path: FieldKey) -> Node:
    match node:
        case FieldTreatment(kind, Numbers(hysteresis=HysteresisBinding(parameters, bind)) as numbers):
            state = states((*path, kind.name, *parameters))
            return FieldTreatment(kind, replace(numbers, scalar=bind(state)))
        case StructTreatment(kind, parts):
            fields = zip(kind.fields, parts, strict=True)
            return StructTreatment(
                kind, tuple(_bind_hysteresis(part, states, (*path, name)) for (name, _), part in fields)
            )
        case _:
            return node


def _field(name: str, kind: Type, branch: _Branch, path: str) -> Node:
    inside = branch.children.get(f"{name}[*]")
    if isinstance(inside, _Branch):
        if not isinstance(kind, Array) or not isinstance(kind.element, Struct):
            raise FilterRefused(f"{path}{name} is a {kind.name}, not an array of messages")
        return _each(kind, _resolve(kind.element, inside, f"{path}{name}[*]."))
    below = branch.children.get(name)
    if below is None:
        return Keep(kind)
    if not isinstance(below, _Branch):
        return _apply(below, kind, path + name, {})
    if not isinstance(kind, Struct):
        hint = f"write {path}{name}[*] for its elements" if isinstance(kind, Array) else ""
        raise FilterRefused(f"{path}{name} is a {kind.name} and has no fields", hint)
    return _resolve(kind, below, f"{path}{name}.")


def _apply(treat: TreatmentForType, kind: Type, path: str, memo: dict[Type, Node]) -> Node:
    # One treatment for everything in `kind`; equal types share it, so arrays can merge them.
    if kind not in memo:
        try:
            found = treat(kind)
        except FilterRefused as error:
            raise FilterRefused(f"{path}: {error}", error.hint) from None
        if found != DESCEND:
            whole = found.kind if isinstance(found, Numbers) else None
            memo[kind] = FieldTreatment(whole or kind, found)
        elif isinstance(kind, Array):
            memo[kind] = _each(kind, _apply(treat, kind.element, path, memo))
        elif isinstance(kind, Struct):
            parts = [_apply(treat, member, f"{path}.{name}", memo) for name, member in kind.fields]
            memo[kind] = _parts(kind, parts)
        else:
            raise FilterRefused(f"{path}: no treatment for {kind.name}")
    return memo[kind]


def _parts(kind: Struct, parts: list[Node]) -> Node:
    kept = all(isinstance(part, Keep) for part in parts)
    return Keep(kind) if kept else StructTreatment(kind, tuple(parts))


def _each(kind: Array, element: Node) -> Node:
    if has_hysteresis(element):
        raise FilterRefused(
            f"hysteresis cannot be used on {kind.name}", "array elements have no identity between messages"
        )
    if isinstance(element, Keep) or kind.size == 0 or kind.element.size == 0:
        return Keep(kind)  # elements without bytes have nothing to treat
    return ArrayTreatment(kind, element)


_Rules: TypeAlias = dict[str, dict[str, object]]

_OUTDOORS: Final = "sensor_msgs/NavSatFix"
_CLEAR: Final[dict[str, object]] = {"clear": True}
_DROP: Final[dict[str, object]] = {"drop": True}
# 2 m with 0.5 m every 5 s left an attacker who knows the habits 1.05 m; this leaves 2.6 m.
_POSITION: Final[dict[str, object]] = {"round": {"step": 4.0, "hysteresis": 2.0}}
_DEGREES: Final[dict[str, object]] = {"round": {"step": 0.02, "hysteresis": 0.01}}  # 2.2 km north


@dataclass(frozen=True)
class Preset:
    """A restriction by name."""

    name: str
    hides: str  # what the receiver no longer learns
    reveals: str  # what an attacker who keeps all messages still learns
    _rules: Callable[[Layout], _Rules]
    rate: float | None = None  # messages a second
    slot: int | None = None  # seconds
    outdoors: int | None = None  # the same for a NavSatFix, whose cells are as much larger

    def restriction(self, layout: Layout) -> Restriction:
        large = layout.type_name == _OUTDOORS and self.outdoors is not None
        return Restriction(
            type=layout.type_name,
            filters=filter_rules(self._rules(layout)),
            rate=self.rate,
            slot=self.outdoors if large else self.slot,
        )


def _header(step: float) -> _Rules:
    return {"header.seq": _CLEAR, "header.stamp": {"round": {"step": step}}}


def _for(types: Mapping[str, _Rules]) -> Callable[[Layout], _Rules]:
    def rules(layout: Layout) -> _Rules:
        if layout.type_name not in types:
            raise FilterRefused(
                f"the preset does not support {layout.type_name}", f"it supports {', '.join(types)}"
            )
        return types[layout.type_name]

    return rules


# Rounding a position alone hides little, so a preset treats the field with its related fields. A grant holds
# what its preset said when it was signed, so a preset may change. A scan has no coarse form: walls to a metre
# are the position to a centimetre.
_COARSE: Final[Mapping[str, _Rules]] = {
    "geometry_msgs/PoseStamped": _header(60) | {"pose.position": _POSITION, "pose.orientation": _CLEAR},
    "geometry_msgs/PoseWithCovarianceStamped": _header(60)
    | {"pose.pose.position": _POSITION, "pose.pose.orientation": _CLEAR, "pose.covariance": _CLEAR},
    "geometry_msgs/PointStamped": _header(60) | {"point": _POSITION},
    "nav_msgs/Odometry": _header(60)
    | {
        "pose.pose.position": _POSITION,
        "pose.pose.orientation": _CLEAR,
        "pose.covariance": _CLEAR,
        "twist": _CLEAR,
    },
    "sensor_msgs/NavSatFix": _header(60)
    | {"latitude": _DEGREES, "longitude": _DEGREES}
    | dict.fromkeys(("status", "altitude", "position_covariance", "position_covariance_type"), _CLEAR),
    "sensor_msgs/JointState": _header(60)
    # Of wheels, they are the way that was gone.
    | {"position": _DROP, "velocity": _DROP, "effort": _DROP},
}
_DIAGNOSTICS: Final[Mapping[str, _Rules]] = {
    "diagnostic_msgs/DiagnosticArray": _header(60)
    | {
        "status": {"sort": True},
        "status[*].name": _CLEAR,
        "status[*].message": _CLEAR,
        "status[*].hardware_id": {"hash": {"key": "diagnostics", "length": 12, "per": "receiver"}},
        "status[*].values": _DROP,
    }
}
_CAMERA: Final[Mapping[str, _Rules]] = {
    # Squares of 32 pixels hide a face at 320 x 240, and show everybody's at 1920 x 1080.
    "sensor_msgs/Image": _header(10) | {"data": {"pixelate": {"across": 16, "block": 32, "levels": 8}}}
}

PRESETS: Final[dict[str, Preset]] = {
    preset.name: preset
    for preset in (
        Preset(
            "coarse-position",
            "the place within cells of 4 m, of 2 km outdoors, joints, heading, speed, uncertainty"
            " and the exact time",
            "the part of the home, and often the room to somebody who knows the habits; that it"
            " moves, to within a minute; the route of cells; of one that sends seldom, little"
            " arrives",
            _for(_COARSE),
            slot=30,
            outdoors=900,
        ),
        Preset(
            "presence-only",
            "all content, the moment at which something begins or ends, and what happens once",
            "in which minutes the publisher is at work, if it sends more than once in 2 s;"
            " of one that sends less, next to nothing arrives; when it registers, connects and"
            " ends, to the moment",
            # Only arrays of fixed length keep their length.
            lambda layout: {name: _CLEAR for name, _ in layout.root.fields},
            slot=60,
        ),
        Preset(
            "anonymous-diagnostics",
            "texts, values, names, hardware numbers, and which part is which for two receivers",
            "how many parts there are and their levels, each part recognised by its pseudonym;"
            " two receivers who compare levels for an hour know which are the same",
            _for(_DIAGNOSTICS),
            rate=0.1,
        ),
        Preset(
            "blurred-camera",
            "colours, and details smaller than a sixteenth of the picture or 32 pixels, such as the"
            " face of somebody who is not close to the camera",
            "light, that something moves and where; whatever is larger than some squares, as a"
            " text; by many pictures of somebody who moves, which of a few known people it is",
            _for(_CAMERA),
            rate=1.0,
        ),
    )
}


def preset(name: str) -> Preset:
    """The preset `name`."""
    if name not in PRESETS:
        raise FilterRefused(f"no preset {name[:40]!r}", f"expected one of {', '.join(PRESETS)}")
    return PRESETS[name]

"""What grants, filters, rights and spans of time are called, and what the policy calls things. Pure.

For people who live with robots and do not program them: short, and the most important field first. A text of
a node or a policy that is shown passes `printable`. A title of the policy is never shown without the name of
ROS beside it: it is a help to people, who decide by the name.
"""

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime
from functools import cache
from typing import Final

from ca.names import TAIL, shown
from grants.errors import GrantError
from grants.model import FilterRule, Restriction, Right, Scalar
from grants.policy.model import type_of
from grants.vocabulary.assess import assess, sentence
from grants.vocabulary.contents import EXACT, Description, describe
from rossec.authority.console.messages import PolicyName
from rossec.errors import MessageError
from rossec.participant.host_types import layout_of
from rossec.peer_limits import printable

MAX_NAME: Final = 120
MINUTE, HOUR, DAY, YEAR = 60, 3600, 86400, 365 * 86400

RIGHTS: Final[Mapping[Right, str]] = {
    Right.PUBLISH: "send",
    Right.SUBSCRIBE: "see",
    Right.CALL: "use",
    Right.PROVIDE: "offer",
    Right.PARAM_GET: "read the setting",
    Right.PARAM_SET: "change the setting",
    Right.GRAPH: "list the names below",
    Right.ADMIN: "manage",
}

_DEGREES: Final = " degrees"
_METRES: Final = 111_320  # of a degree of latitude; of longitude it is less, away from the equator
_UNITS: Final = ((YEAR, "year"), (DAY, "day"), (HOUR, "hour"), (MINUTE, "minute"))


def name(text: object) -> str:
    return printable(shown(text) if isinstance(text, str) else text, MAX_NAME)


def count(number: int, what: str) -> str:
    return f"{number} {what}" if number == 1 else f"{number} {what}s"


def listing(items: Iterable[str], limit: int = 4) -> str:
    given = list(items)
    shown, rest = given[:limit], len(given) - limit
    if rest > 0:
        shown.append(f"{rest} more")
    return shown[0] if len(shown) == 1 else f"{', '.join(shown[:-1])} and {shown[-1]}"


def rights(given: Right) -> str:
    return listing((RIGHTS[right] for right in given), len(RIGHTS))


def duration(seconds: int) -> str:
    """The largest whole unit: `23 hours`, `30 days`."""
    for size, unit in _UNITS:
        if seconds >= size:
            return count(seconds // size, unit)
    return "less than a minute"


def ago(at: int, now: int) -> str:
    return "just now" if now - at < MINUTE else f"{duration(now - at)} ago"


def left(until: int, now: int) -> str:
    """`23 hours left`; `over` when there is none. A day of which seconds are over is a day."""
    span = until - now
    return f"{duration(span + span // 100)} left" if span > 0 else "over"


def day(time: int) -> str:
    return datetime.fromtimestamp(time).astimezone().strftime("%-d %B %Y, %H:%M")


def term(expires: int, cap: int, now: int) -> str:
    if cap <= expires:
        return left(expires, now)
    return f"renewed by itself, {left(cap, now)}" if cap > now else "over"


def topic(pattern: str) -> str:
    if pattern == "/**":
        return "everything"
    if pattern.endswith("/**") and "*" not in pattern[:-3]:
        return f"everything below {topic(pattern[:-3])}"
    return name(pattern).replace(TAIL, "_…")


# By operator, with the field's name, its unit (a space before it) and the parameters by name.
OPERATORS: Final[Mapping[str, str]] = {
    "clear": "without {field}",
    "drop": "without {field}",
    "zero": "{field} blanked out",
    "round": "{field} to {step}{unit}",
    "clamp": "{field} between {low} and {high}{unit}",
    "set": "{field} always {value}",
    "redact": "{field} replaced by {text}",
    "truncate": "only the first {length} of {field}",
    "hash": "{field} as a pseudonym",
    "pixelate": "{field} in squares",
    "rooms": "{field} as the room alone",
    "sort": "{field} in no order of their own",
}

# Ends of field paths: what people call them, the unit of their numbers. The order is that of
# importance: the first that fits is said first.
_FIELDS: Final[tuple[tuple[str, str, str], ...]] = (
    ("position", "position", "m"),
    ("position.x", "position to the east", "m"),
    ("position.y", "position to the north", "m"),
    ("position.z", "height", "m"),
    ("point", "position", "m"),
    ("latitude", "latitude", "degrees"),
    ("longitude", "longitude", "degrees"),
    ("altitude", "height", "m"),
    ("translation", "position", "m"),
    ("ranges", "distances", "m"),
    ("intensities", "brightness of the rays", ""),
    ("data", "content", ""),
    ("orientation", "direction", ""),
    ("rotation", "direction", ""),
    ("header.frame_id", "the map's name", ""),
    ("child_frame_id", "the robot's frame", ""),
    ("pose", "position and direction", ""),
    ("twist", "speed", ""),
    ("linear", "speed", "m/s"),
    ("angular", "turning", ""),
    ("covariance", "uncertainty", ""),
    ("position_covariance", "uncertainty", ""),
    ("status[*].message", "messages", ""),
    ("status[*].hardware_id", "hardware numbers", ""),
    ("status[*].values", "measured values", ""),
    ("percentage", "charge", ""),
    ("voltage", "voltage", "V"),
    ("header.stamp", "time", "s"),
    ("stamp", "time", "s"),
    ("header.seq", "numbering", ""),
    ("header", "map, time and numbering", ""),
)
_OWN_NAMES: Final[Mapping[tuple[str, str], str]] = {
    ("sensor_msgs/Image", "data"): "picture",
    ("sensor_msgs/CompressedImage", "data"): "picture",
    ("sensor_msgs/PointCloud2", "data"): "points",
    ("std_msgs/String", "data"): "text",
}


_COMPARISON: Final = re.compile(
    r"""msg\.([A-Za-z][\w.]*) (==|!=|<=|>=|<|>) ("[^"\\]*"|'[^'\\]*'|-?\d+(?:\.\d+)?)""", re.ASCII
)
_COMPARED: Final[Mapping[str, str]] = {
    "==": "",
    "!=": "not ",
    "<": "below ",
    ">": "above ",
    "<=": "at most ",
    ">=": "at least ",
}


def field_name(path: str, type_name: str | None = None) -> str:
    own = _OWN_NAMES.get((type_name or "", path))
    return own if own is not None else _field(path)[1]


def _field(path: str) -> tuple[int, str, str]:
    fits = [
        (len(end), order, said, unit)
        for order, (end, said, unit) in enumerate(_FIELDS)
        if path == end or path.endswith(f".{end}")
    ]
    if not fits:
        return len(_FIELDS), name(path.replace("[*]", "").replace("_", " ")), ""
    _, order, said, unit = max(fits)
    return order, said, unit and f" {unit}"


def _value(value: Scalar) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    return f"“{printable(value, 40)}”" if isinstance(value, str) else f"{value:g}"


def filter_rule(rule: FilterRule, type_name: str | None = None) -> str:
    _, _, unit = _field(rule.path)
    given = {parameter: _value(value) for parameter, value in rule.parameters}
    names = {"field": field_name(rule.path, type_name), "unit": unit}
    text = OPERATORS[rule.operator].format_map(given | names)
    if rule.operator == "pixelate":
        parts = [f" of {given['block']} pixels" if "block" in given else ""]
        parts += [f"at most {given['across']} across"] if "across" in given else []
        parts += [f"{given['levels']} shades of grey"] if "levels" in given else []
        parts += ["only in a part of it"] if "width" in given else []
        text += ", ".join(parts)
    if unit == _DEGREES and rule.operator == "round":
        text += f" (about {_METRES * float(dict(rule.parameters)['step']):.0f} m)"
    return text


def filters(rules: Iterable[FilterRule], type_name: str | None = None) -> list[str]:
    ordered = sorted(rules, key=lambda rule: (_field(rule.path)[0], rule.path))
    return list(dict.fromkeys(filter_rule(rule, type_name) for rule in ordered))


def rate(number: float) -> str:
    """`at most 5 a second`, `at most one every 5 s`."""
    return f"at most {number:g} a second" if number >= 1 else f"at most one every {1 / number:.3g} s"


def slot(seconds: int) -> str:
    return f"one at the start of each {seconds} s"


def restriction(given: Restriction) -> list[str]:
    parts = filters(given.filters, given.type)
    parts += [] if given.rate is None else [rate(given.rate)]
    parts += [] if given.slot is None else [slot(given.slot)]
    return [*parts, *(f"only when {condition(text, given.type)}" for text in given.conditions)]


def condition(text: str, type_name: str | None = None) -> str:
    found = _COMPARISON.fullmatch(text)
    if found is None:
        return printable(text, 200)
    path, operator, value = found.groups()
    shown = f"“{printable(value[1:-1], 40)}”" if value[0] in "\"'" else value
    return f"{field_name(path, type_name)} is {_COMPARED[operator]}{shown}"


def restrictions(given: Iterable[Restriction]) -> str:
    """Everything that applies together: `position to 2 m, without direction`; else empty."""
    # Where a level of the vocabulary holds, it is said first: `where it is: the room (position ...)`.
    together = list(given)
    parts = ", ".join(dict.fromkeys(part for each in together for part in restriction(each)))
    said = levels(together)
    return f"{said} ({parts})" if said else parts


def plain(given: Iterable[Restriction]) -> str:
    """As `restrictions`, for people who do not know fields: by levels where these are known."""
    together = list(given)
    return levels(together) or restrictions(together)


def levels(given: Sequence[Restriction]) -> str:
    """The words that are at a level: `where it is: the room; not how it moves`; else empty."""
    kind = next((each.type for each in given if each.type is not None), None)
    described = None if kind is None else description(kind)
    if described is None:
        return ""
    found = assess(described, given).values()
    return sentence(one for one in found if one.level != EXACT or one.conditions)


@cache
def description(type_name: str) -> Description | None:
    try:
        return describe(layout_of(type_name))
    except (GrantError, MessageError):
        return None


MAX_TITLE: Final = 60


@dataclass(frozen=True)
class Names:
    """Titles by name, as the name is and as it is shown; types by topic or pattern."""

    titles: dict[str, str] = field(default_factory=dict)
    types: dict[str, str] = field(default_factory=dict)

    @classmethod
    def of(cls, found: Iterable[PolicyName]) -> "Names":
        titles: dict[str, str] = {}
        types: dict[str, str] = {}
        for each in found:
            if each.type:
                types[each.name] = each.type
            if each.title:
                title = printable(each.title, MAX_TITLE)
                titles |= dict.fromkeys((each.name, topic(each.name)), title)
        return cls(titles, types)

    def title(self, name: str) -> str:
        return self.titles.get(name, "")

    def type_of(self, topic: str) -> str:
        return type_of(self.types, topic) or ""


NONE: Final = Names()

"""What lint can say, one entry in `ADVICE` for each code, and what to write instead.

A code is an interface: scripts compare it, documents explain it (docs/spec/policy.md has the same table), so
it keeps its meaning and is never given to anything else. Advice that `rossec policy check` refuses is worse
than none: a suggested treatment is compiled together with the other filters of the topic, and the first that
compiles is taken. If none does, the advice names the field and leaves the treatment to the reader.
"""

import json
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import Final

from grants.errors import GrantError
from grants.filters.compile import compile_filter, preset
from grants.model import FilterRule, Scalar
from grants.policy.lint_views import Aspect, View
from grants.policy.privacy import leaf_paths


@dataclass(frozen=True)
class Advice:
    says: str
    do: str


ADVICE: Final[dict[str, Advice]] = {
    # rules
    "no-reason": Advice("a rule without `why`", "say why: people are shown it"),
    "no-lifetime": Advice("neither the rule nor `defaults` has a `lifetime`", "say how long a grant holds"),
    "long-lifetime": Advice("rights for more than a year", "shorten it; renewal is automatic"),
    "wide-right": Advice(
        "a right to act on everything below a name, not the node's own",
        "name the topics and services one by one",
    ),
    "speaks-for-others": Advice(
        "several nodes may publish, provide or set names of each other",
        'write `"{node}/pose"`, the own names of each',
    ),
    "keep-when-stale": Advice(
        "connections that outlive withheld revocation data",
        "use `on_stale: keep` only for what must not stop",
    ),
    "never-decides": Advice(
        "a right that another rule always denies, or allows before it is asked for", "remove it"
    ),
    "unused-identity": Advice("an identity that no rule names", "remove it, or use it"),
    "unused-group": Advice("a group that no rule names", "remove it, or use it"),
    "unused-filter": Advice("a filter that no rule uses", "remove it, or use it"),
    "unused-type": Advice("the type of a topic that no rule names", "remove it, or correct it"),
    # conditions
    "condition-tells": Advice(
        "a condition reads a field that the same receiver may not see: that a message comes tells its value",
        "remove the condition, or leave the field as it is",
    ),
    # fields of the same message
    "position-open": Advice("a coordinate is filtered, another is not", "filter it as well"),
    "movement-open": Advice(
        "the position is filtered, the velocity is not: the path follows by integration", "clear the velocity"
    ),
    "heading-open": Advice(
        "the position is filtered, the orientation is not: turns show the direction of movement",
        "clear the orientation",
    ),
    "covariance-open": Advice(
        "the position is filtered, its covariance is not: it changes with the hidden value",
        "clear the covariance",
    ),
    "time-open": Advice(
        "the position is filtered, stamps or counts are not: they tell when a cell changed",
        "round the stamp, clear `seq`",
    ),
    "name-open": Advice(
        "one name of a thing is hidden, another is not: a name that occurs once links the rest", "clear it"
    ),
    # parameters
    "no-hysteresis": Advice(
        "rounded without hysteresis: changes at a border show the exact position", "add half of the step"
    ),
    "no-rate": Advice(
        "coarse, but every message is sent: they average to the exact value, and tell when it changes",
        "limit the rate",
    ),
    "rounded-array": Advice(
        "values of an array are rounded: together they give the exact ones", "clear the array"
    ),
    "step-does-nothing": Advice("a step smaller than what the sensor errs", "use a larger step"),
    "hysteresis-does-nothing": Advice("a hysteresis below a tenth of the step", "use half of the step"),
    "rate-does-nothing": Advice(
        "a rate as high as the topic's own: a robot is seen every half metre", "lower the rate"
    ),
    "pixels-too-small": Advice(
        "squares in which a face is recognised", "at most 16 across, of at least 32 pixels"
    ),
    "pixels-fixed": Advice(
        "squares of so many pixels, whatever the size of the picture: a large one shows a face",
        "say how many there are `across`, at most",
    ),
    "region-open": Advice(
        "only a region of a picture is in squares: what is beside it is as it is", "treat the whole picture"
    ),
    "no-grey-levels": Advice(
        "squares that show the colour of one pixel: ten moving pictures show a face", "add 8 levels of grey"
    ),
    "rooms-too-small": Advice("rooms below 1 m² or 0.8 m: a fine grid", "give real rooms, or round to 4 m"),
    "clamp-keeps-values": Advice("a clamped position is exact between the limits", "round it, or clear it"),
    # other topics and receivers
    "exact-relative": Advice(
        "the receiver sees another topic exactly that shows the same", "filter that as well"
    ),
    "presence-open": Advice(
        "one topic is seen in slots, another of the same place as its messages come: they tell the moment",
        "put it in slots as well",
    ),
    "service-tells": Advice(
        "the position is filtered, and a service answers with it, the way or the map",
        "take the right to call it out",
    ),
    "graph-tells": Advice(
        "the right to the graph beside something hidden: it tells who publishes, when, and how many messages",
        "take it out, or limit it to other names",
    ),
    "wheels-open": Advice(
        "the position is filtered, and joints are in steps: those of wheels give the path", "clear the joints"
    ),
    "unknown-type": Advice(
        "beside something filtered, the receiver sees a topic of which lint knows nothing",
        "add its type to `types`, say what it tells in `vocabulary`, or withhold it",
    ),
    "two-versions": Advice(
        "one receiver or owner sees two grids that do not nest: together they are finer",
        "use the same step, or a multiple",
    ),
    "shared-pseudonym": Advice(
        "two receivers, or all of a pattern, get the same pseudonyms: together they know more",
        "add `per: receiver`",
    ),
    "second-receiver": Advice(
        "another node of the same owner sees exactly what this one sees coarsely", "filter it for both"
    ),
}


# Codes of what gives nothing away; every other code is a leak, or a right that is too wide.
FORM: Final = {
    *("no-reason", "no-lifetime", "long-lifetime", "never-decides"),
    *("unused-identity", "unused-group", "unused-filter", "unused-type"),
}


@dataclass(frozen=True)
class Suggestion:
    """A change of rule `rule`: a treatment of a field, a rate, a condition less, another pattern."""

    rule: str
    topic: str = ""  # the one whose filter gets `treatment`, in place of any treatment of the same field
    treatment: FilterRule | None = None
    rate: float | None = None  # messages a second
    without: str = ""  # the condition to remove
    instead: str = ""  # the pattern to write in place of `topic`


@dataclass(frozen=True, order=True)
class LintFinding:
    line: int
    code: str
    message: str
    hint: str
    suggestions: tuple[Suggestion, ...] = field(default=(), compare=False)

    @property
    def is_leak(self) -> bool:
        return self.code not in FORM

    def as_json(self) -> dict[str, object]:
        return {name: getattr(self, name) for name in ("line", "code", "message", "hint")}


COARSE_STEP: Final = 4.0  # metres, as the preset coarse-position
COARSE_DEGREES: Final = 0.02  # about two kilometres
COARSE_JOINT: Final = 0.5  # radians
COARSE_TIME: Final = 60  # seconds
COARSE_RATE: Final = 0.03
ACROSS: Final = 16
BLOCK: Final = 32
LEVELS: Final = 8
ROOM_REACH: Final = 0.5  # metres
SHARE: Final = 2  # the hysteresis is this part of a step

_TELLING: Final = (
    *(Aspect.POSITION, Aspect.HEADING, Aspect.MOVEMENT, Aspect.COVARIANCE, Aspect.SURROUNDINGS, Aspect.IMAGE),
    *(Aspect.JOINT, Aspect.JOINT_RATE, Aspect.STATE, Aspect.WARMTH, Aspect.HUMIDITY, Aspect.LIGHT),
    Aspect.SOUND,
)

Closed = tuple[str, str, tuple[Suggestion, ...]]


def closing(view: View, open_fields: Sequence[str]) -> Closed:
    """Close `open_fields`: the path to name, the text to add, and the same as a change.

    The widest message that holds nothing else comes first: `twist` rather than its thirteen leaves.
    """
    for paths in _wholes(view, open_fields):
        rules = tuple(_closed(view, path) for path in paths)
        if fits(view, rules):
            return paths[0], ", ".join(map(written, rules)), changes(view, rules)
    return open_fields[0], "a treatment of it, in a filter that does not overlap", ()


def _wholes(view: View, open_fields: Sequence[str]) -> Iterable[list[str]]:
    depth = max(path.count(".") for path in open_fields)
    for steps in range(1, depth + 1):
        begins = (".".join(path.split(".")[:steps]).removesuffix("[*]") for path in open_fields)
        paths = list(dict.fromkeys(begins))
        if all(_is_only(view, path, open_fields) for path in paths):
            yield paths
    yield list(open_fields)


def _is_only(view: View, path: str, open_fields: Sequence[str]) -> bool:
    leaves = leaf_paths(view.layout) if view.layout is not None else []
    return all(leaf in open_fields for leaf in leaves if _is_below(leaf, path))


def _is_below(leaf: str, path: str) -> bool:
    bare, above = leaf.replace("[*]", ""), path.replace("[*]", "")
    return bare == above or bare.startswith(f"{above}.")


def _closed(view: View, path: str) -> FilterRule:
    match view.aspects.get(path):
        case Aspect.TIME:
            return FilterRule(path, "round", (("step", COARSE_TIME),))
        case Aspect.IMAGE if view.layout is not None and view.layout.type_name.endswith("/Image"):
            squares = (("across", ACROSS), ("block", BLOCK), ("levels", LEVELS))
            return FilterRule(path, "pixelate", squares)
        case _:
            return FilterRule(path, "clear")


def replacing(view: View, old: FilterRule, better: FilterRule) -> tuple[str, tuple[Suggestion, ...]]:
    for candidate in (better, FilterRule(old.path, "clear")):
        if fits(view, (candidate,), old):
            return written(candidate), changes(view, (candidate,), old)
    return "another treatment", ()


def coarsening(view: View) -> tuple[str, tuple[Suggestion, ...]]:
    if view.is_below_pattern:
        return f"name the topics it needs instead of {view.pattern}", ()
    if view.layout is None:
        return f"withhold {view.topic}, or add its type to types and filter it", ()
    begin = f"filter {view.topic} as well"
    try:
        found = preset("coarse-position").restriction(view.layout)
    except GrantError:
        return closing_all(view, view.exact(*_TELLING) or view.exact(Aspect.NAME))
    suggestions = [*changes(view, found.filters)] if fits(view, found.filters) else []
    if suggestions and found.slot is not None:
        suggestions.append(Suggestion(view.rule.id, rate=1 / found.slot))
    return f"{begin}: {{use: coarse-position}}", (*suggestions,)


def closing_all(view: View, telling: Sequence[str]) -> tuple[str, tuple[Suggestion, ...]]:
    if view.is_below_pattern:
        return f"name the topics it needs instead of {view.pattern}", ()
    arrays = dict.fromkeys(path.partition("[*]")[0] for path in telling if "[*]" in path)
    alone = [path for path in telling if "[*]" not in path]
    wholes = next(iter(_wholes(view, alone)), []) if alone else []
    rules, begin = tuple(_closed(view, path) for path in (*arrays, *wholes)), f"filter {view.topic} as well"
    if not fits(view, rules):
        return begin, ()
    return f"{begin}: {', '.join(map(written, rules))}", changes(view, rules)


def limiting(view: View, rate: float = COARSE_RATE) -> tuple[str, tuple[Suggestion, ...]]:
    return f"add limit: {{rate: {rate:g}}}", (Suggestion(view.rule.id, rate=rate),)


def fits(view: View, rules: Iterable[FilterRule], beside: FilterRule | None = None) -> bool:
    new = {rule.path: rule for rule in rules}
    if view.layout is None or not new:
        return False
    restriction = view.place(beside)[1].restriction
    old = {rule.path: rule for rule in restriction.filters} if restriction is not None else {}
    try:
        compile_filter(view.layout, (old | new).values())
    except GrantError:
        return False
    return True


def changes(
    view: View, rules: Iterable[FilterRule], beside: FilterRule | None = None
) -> tuple[Suggestion, ...]:
    rule, clause = view.place(beside)
    if clause.pattern != view.topic:
        return ()
    return tuple(Suggestion(rule.id, clause.written or clause.pattern, each) for each in rules)


def written(rule: FilterRule) -> str:
    path = f'"{rule.path}"' if "[" in rule.path else rule.path
    parameters = dict(rule.parameters)
    if not parameters:
        return f"{path}: {{{rule.operator}: true}}"
    if len(parameters) == 1 and rule.operator != "rooms":
        [value] = parameters.values()
        return f"{path}: {{{rule.operator}: {_scalar(value)}}}"
    names = sorted(parameters, key=lambda name: (name == "hysteresis", name))
    named = ", ".join(f"{name}: {_scalar(parameters[name])}" for name in names)
    return f"{path}: {{{rule.operator}: {{{named}}}}}"


def _scalar(value: Scalar) -> str:
    plain = not isinstance(value, str) or value.isidentifier()
    return str(value) if plain else json.dumps(value)

"""What lint says, and what to write instead.

A code is an interface: scripts compare it, so it keeps its meaning and is never given to anything else. The
table of all is in docs/spec/policy.md, "Lint", and tests hold what is given to it. Advice that
`rossec policy check` refuses is worse than none: a suggested treatment is compiled together with the other
filters of the topic, and the first that compiles is taken. If none does, the advice names the field and
leaves the treatment to the reader.
"""

import json
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import Final

from grants.errors import GrantError
from grants.filters.compile import compile_filter, preset
from grants.model import FilterRule, Scalar
from grants.policy.assertions import below
from grants.policy.lint_views import Aspect, View
from grants.policy.privacy import leaf_paths

# Codes of what gives nothing away; every other code is a leak, or a right that is too wide.
HARMLESS_CODES: Final = {
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
        return self.code not in HARMLESS_CODES

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
    leaves = leaf_paths(view.layout) if view.layout is not None else []
    for steps in range(1, depth + 1):
        begins = (".".join(path.split(".")[:steps]).removesuffix("[*]") for path in open_fields)
        paths = list(dict.fromkeys(begins))
        if all(leaf in open_fields for path in paths for leaf in below(leaves, path)):
            yield paths
    yield list(open_fields)


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

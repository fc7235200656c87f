"""Advice on a valid policy: what is allowed but unwise, by a table of checks (`CHECKS`).

Precision removed from one field is often still in related fields, on other topics, or with another node of
the same owner. So each check sees what a receiver gets from all rules together (`lint_views`).
"""

from collections.abc import Callable, Iterator
from typing import Final

from ca.names import is_alias
from grants.conditions import fields_read
from grants.model import FilterRule, Right, Scalar
from grants.policy import lint_topics
from grants.policy.lint_findings import (
    ACROSS,
    BLOCK,
    COARSE_DEGREES,
    COARSE_JOINT,
    COARSE_STEP,
    COARSE_TIME,
    LEVELS,
    ROOM_REACH,
    SHARE,
    LintFinding,
    Suggestion,
    limiting,
    replacing,
)
from grants.policy.lint_views import Aspect, LayoutOf, LintedPolicy, Precision, View, too_fine, too_small
from grants.policy.model import Clause, Effect, Policy, PolicyRule, SubjectPattern
from grants.policy.names import NODE, any_node, gives, includes, intersects, is_own, speaks_for_others
from grants.vocabulary.assess import filters_of
from grants.vocabulary.levels import NARROWEST, SMALLEST, Treatment, narrowest, smallest

_FASTEST: Final = 2.0  # a second: at a walk one message every half metre
_SMALLEST_SHARE: Final = 10  # a hysteresis below this part of a step is noise
_CELLS: Final = ("round", "rooms")
_MOST_LEVELS: Final = 16
_REGION: Final = ("x", "y", "width", "height")
_ACTING: Final = Right.PUBLISH | Right.CALL | Right.PARAM_SET | Right.ADMIN
_SPEAKING: Final = Right.PUBLISH | Right.PROVIDE | Right.PARAM_SET
_LONG: Final = 366 * 86400
_DENSE: Final = (Aspect.POSITION, Aspect.SURROUNDINGS)


# Floors of parameters are what sensors err anyway, or what the attackers of docs/spec/policy.md, "Lint",
# needed.
def parameters(linted: LintedPolicy) -> Iterator[LintFinding]:
    for view in linted.all_views:
        for rule, paths in _treated(view).items():
            if (advise := _OPERATORS.get(rule.operator)) is not None:
                yield from advise(view, rule, paths)


def rates(linted: LintedPolicy) -> Iterator[LintFinding]:
    for view in linted.all_views:
        coarse = any(view.filter_on(path).operator in _CELLS for path in view.coarse(Aspect.POSITION))
        coarse = coarse or bool(view.coarse(Aspect.IMAGE))
        if view.has_slot or not (coarse or view.is_empty):
            continue
        hint, suggestions = limiting(view)
        begin = f"rule {view.rule.id}: {view.topic} is {'coarse' if coarse else 'empty'}"
        if view.verdict.rate is None:
            message = f"{begin}, but sent at the full rate"
            yield LintFinding(view.rule.line, "no-rate", message, hint, suggestions)
        elif view.verdict.rate > _FASTEST:
            message = f"{begin}, but {view.verdict.rate:g} messages a second hide no movement"
            yield LintFinding(view.rule.line, "rate-does-nothing", message, hint, suggestions)


def _treated(view: View) -> dict[FilterRule, list[str]]:
    # The leaves that show something, by the filter that treats them; not what another hides.
    found: dict[FilterRule, list[str]] = {}
    for path in view.aspects:
        if view.left(path) is not Precision.HIDDEN:
            for rule in filters_of(view.filters, path):
                found.setdefault(rule, []).append(path)
    return found


def _round(view: View, rule: FilterRule, paths: list[str]) -> Iterator[LintFinding]:
    exact = [path for path in paths if view.left(path) is Precision.EXACT]
    fine = [path for path in exact if too_fine(rule, view.aspects[path], path)]
    dense = [path for path in paths if view.aspects[path] in _DENSE]
    if fine:
        what = f"{rule.path} of {view.topic} is rounded to {_step(rule):g}, less than sensors err"
        match view.aspects[fine[0]]:
            case Aspect.POSITION:
                degrees = fine[0].endswith(("latitude", "longitude"))
                better = _with_hysteresis(rule, COARSE_DEGREES if degrees else COARSE_STEP)
            case Aspect.JOINT | Aspect.TIME as aspect:
                step = COARSE_JOINT if aspect is Aspect.JOINT else COARSE_TIME
                better = FilterRule(rule.path, "round", (("step", step),))
            case _:
                better = FilterRule(rule.path, "clear")
        yield _finding(view, rule, "step-does-nothing", what, better)
    elif any("[*]" in path or view.aspects[path] is Aspect.SURROUNDINGS for path in dense):
        # An array has no hysteresis (docs/spec/grant.md 6.1), so it is cleared.
        what = f"values of the array {rule.path} of {view.topic} together give the exact ones"
        yield _finding(view, rule, "rounded-array", what, FilterRule(rule.path, "clear"))
    elif any(view.aspects[path] is Aspect.POSITION for path in paths):
        share = dict(rule.parameters).get("hysteresis")
        better = _with_hysteresis(rule, _step(rule))
        same = (dict(each.parameters) for each in view.filters if each.path == rule.path)
        if share is None and not any("hysteresis" in each for each in same):
            yield _finding(view, rule, "no-hysteresis", f"{rule.path} is rounded without hysteresis", better)
        elif share is not None and float(share) * _SMALLEST_SHARE < _step(rule):
            what = f"a hysteresis of {share} on {rule.path} of {view.topic} is within the noise"
            yield _finding(view, rule, "hysteresis-does-nothing", what, better)


def _with_hysteresis(rule: FilterRule, step: float) -> FilterRule:
    return FilterRule(rule.path, "round", (("hysteresis", step / SHARE), ("step", step)))


def _step(rule: FilterRule) -> float:
    return float(dict(rule.parameters)["step"])


def _clamp(view: View, rule: FilterRule, paths: list[str]) -> Iterator[LintFinding]:
    places = [path for path in paths if view.aspects[path] is Aspect.POSITION]
    if places and all(view.left(path) is Precision.EXACT for path in places):
        what = f"{rule.path} of {view.topic} is clamped, and exact between the limits"
        yield _finding(view, rule, "clamp-keeps-values", what, _with_hysteresis(rule, COARSE_STEP))


def _rooms(view: View, rule: FilterRule, _paths: list[str]) -> Iterator[LintFinding]:
    plan = Treatment(rule.operator, rule.parameters)
    if smallest(plan) < SMALLEST or narrowest(plan) < NARROWEST:
        what = f"the rooms for {rule.path} of {view.topic} are smaller than rooms: a grid"
        better = _with_hysteresis(FilterRule(rule.path, "round"), COARSE_STEP)
        yield _finding(view, rule, "rooms-too-small", what, better)
    elif "hysteresis" not in dict(rule.parameters):
        what = f"{rule.path} is snapped to rooms without hysteresis: a door tells the position"
        yield _finding(view, rule, "no-hysteresis", what, _with(rule, hysteresis=ROOM_REACH))


def _pixelate(view: View, rule: FilterRule, _paths: list[str]) -> Iterator[LintFinding]:
    parameters = dict(rule.parameters)
    levels, block = parameters.get("levels"), int(parameters.get("block", 0))
    squares = _with(rule, across=ACROSS, block=max(block, BLOCK), levels=LEVELS)
    others = (dict(each.parameters) for each in filters_of(view.filters, rule.path) if each != rule)
    if "width" in parameters and all("width" in each for each in others):
        what = f"only a region of {view.topic} is in squares: beside it everything is as it is"
        whole = tuple(item for item in squares.parameters if item[0] not in _REGION)
        yield _finding(view, rule, "region-open", what, FilterRule(rule.path, rule.operator, whole))
    elif too_small(rule):
        size = f"of {block} pixels" if "block" in parameters else "as small as these"
        what = f"squares {size} of {view.topic} hide nobody"
        yield _finding(view, rule, "pixels-too-small", what, squares)
    elif "across" not in parameters:
        what = f"squares of {block} pixels show a face where pictures of {view.topic} are large"
        yield _finding(view, rule, "pixels-fixed", what, squares)
    elif levels is None or int(levels) > _MOST_LEVELS:
        what = f"squares of {view.topic} in full colours show a face in ten moving pictures"
        yield _finding(view, rule, "no-grey-levels", what, _with(rule, levels=LEVELS))


def _with(rule: FilterRule, **changed: float) -> FilterRule:
    parameters: dict[str, Scalar] = {**dict(rule.parameters), **changed}
    return FilterRule(rule.path, rule.operator, tuple(sorted(parameters.items())))


def _finding(view: View, old: FilterRule, code: str, what: str, better: FilterRule) -> LintFinding:
    text, suggestions = replacing(view, old, better)
    rule, _ = view.place(old)
    return LintFinding(rule.line, code, f"rule {rule.id}: {what}", f"write {text}", suggestions)


_OPERATORS: Final[dict[str, Callable[[View, FilterRule, list[str]], Iterator[LintFinding]]]] = {
    "round": _round,
    "clamp": _clamp,
    "pixelate": _pixelate,
    "rooms": _rooms,
}


def reasons_and_times(linted: LintedPolicy) -> Iterator[LintFinding]:
    for rule in linted.policy.rules:
        if not rule.why:
            yield _of(rule, "no-reason", "gives no reason", "add why: ...")
        if rule.effect is Effect.DENY:
            continue
        if not rule.has_lifetime and not linted.policy.defaults.has_lifetime:
            yield _of(rule, "no-lifetime", "has no lifetime", "add lifetime: to the rule or to defaults")
        if max(rule.lifetime, rule.renew_until) > _LONG:
            yield _of(rule, "long-lifetime", "holds for more than a year", "shorten it")


def width(linted: LintedPolicy) -> Iterator[LintFinding]:
    for rule in _giving(linted):
        for clause in rule.clauses:
            pattern, nodes = clause.pattern, {who.node for who in rule.who if who.node is not None}
            bases = [(who.node or "*").removesuffix("/**") for who in rule.who]
            if is_own(pattern) or all("*" not in base and pattern.startswith(f"{base}/") for base in bases):
                continue
            what = f"{clause.right.label} on {pattern}"
            are_many = len(nodes) > 1 or any("*" in node for node in nodes)
            if clause.right & _ACTING and "**" in pattern:
                hint = "name the topics and services one by one"
                yield _of(rule, "wide-right", f"{what} may move anything", hint, ": ")
            elif clause.right & _SPEAKING and "*" in pattern and are_many:
                message = f"with {what} each of {rule.subjects_text} can act for the others"
                [first, *others] = [who.node for who in rule.who]
                own = speaks_for_others(pattern, [first, *others])
                if not others and first is not None and pattern.startswith(f"{first}/"):
                    own = NODE + pattern.removeprefix(first)
                hint = f'write "{own}"' if own else "give each node its own names, in a rule of its own"
                changes = () if own is None else (Suggestion(rule.id, pattern, instead=own),)
                yield _of(rule, "speaks-for-others", message, hint, ": ", *changes)


def stale(linted: LintedPolicy) -> Iterator[LintFinding]:
    for rule in _giving(linted):
        if rule.keep_when_stale:
            what = ", ".join(sorted({clause.pattern for clause in rule.clauses}))
            message = f"if revocation data is withheld, {what} stays connected"
            hint = "use on_stale: keep only for what must not stop, as an emergency stop"
            yield _of(rule, "keep-when-stale", message, hint, ": ")


def shadowed(linted: LintedPolicy) -> Iterator[LintFinding]:
    denials = [rule for rule in linted.policy.rules if rule.effect is Effect.DENY]
    allowing = [rule for rule in linted.policy.rules if rule.effect is Effect.ALLOW]
    for rule in _giving(linted):
        stronger = [*denials, *(allowing if rule.effect is Effect.PROMPT else ())]
        for clause in rule.clauses:
            other = next((each for each in stronger if _always_decides(each, rule, clause)), None)
            if other is not None:
                verb = "denied" if other.effect is Effect.DENY else "allowed"
                what = f"{clause.right.label} {clause.pattern} never applies"
                message = f"{what}: it is always {verb} by rule {other.id}"
                yield _of(rule, "never-decides", message, "remove it, or narrow the other", ": ")


def _always_decides(other: PolicyRule, rule: PolicyRule, clause: Clause) -> bool:
    right, requested = clause.right, clause.pattern
    patterns = [each.pattern for each in other.clauses if each.right is right]
    if not any(x == requested if is_own(x) else gives(x, right, any_node(requested)) for x in patterns):
        return False
    for who in rule.who:
        for one in other.exceptions:  # may one of them be such a node?
            other_key = None not in (one.key, who.key) and one.key != who.key
            if not other_key and (one.node is None or who.node is None or intersects(one.node, who.node)):
                return False
        if not any(_is_wider(each, who) for each in other.who):
            return False
    return True


def _is_wider(one: SubjectPattern, other: SubjectPattern) -> bool:
    if one.key is not None and one.key != other.key:
        return False
    if is_alias(other.node or "") and not is_alias(one.node or ""):
        return False  # a foreign node is meant only where its domain is named
    return one.node is None or (other.node is not None and includes(one.node, other.node))


def unused(linted: LintedPolicy) -> Iterator[LintFinding]:
    policy = linted.policy
    used = {who.label for rule in policy.rules for who in (*rule.who, *rule.exceptions)}
    clauses = [clause for rule in policy.rules for clause in rule.clauses]
    filtered = {clause.restriction.filters for clause in clauses if clause.restriction is not None}
    filters = [name for name, rules in policy.filters.items() if tuple(sorted(rules)) not in filtered]
    identities = sorted(policy.identities.keys() - used)
    for kind, idle in (("identity", identities), ("group", policy.unused_groups), ("filter", filters)):
        for name in idle:
            message = f"{kind} {name} is used by no rule"
            yield LintFinding(0, f"unused-{kind}", message, "remove it, or use it")
    names = {any_node(clause.pattern) for clause in clauses}
    wide = [pattern for pattern in names if "*" in pattern]
    for topic in policy.types:
        name = any_node(topic)
        below = any(includes(pattern, name) for pattern in wide)
        above = "*" in name and any(includes(name, each) for each in names)
        if name not in names and not below and not above:
            message = f"the type of {topic} is used by no rule"
            yield LintFinding(0, "unused-type", message, "remove it, or correct the name")


def _giving(linted: LintedPolicy) -> Iterator[PolicyRule]:
    return (rule for rule in linted.policy.rules if rule.effect is not Effect.DENY)


def _of(
    rule: PolicyRule, code: str, message: str, hint: str, joint: str = " ", *more: Suggestion
) -> LintFinding:
    return LintFinding(rule.line, code, f"rule {rule.id}{joint}{message}", hint, more)


# That a message comes says that the condition held: of a position that is cleared, `x < 5` told the
# crossing to 0.13 s (docs/spec/policy.md, "Lint"), and `frame_id == "map"` tells a cleared name.
def oracles(linted: LintedPolicy) -> Iterator[LintFinding]:
    read = (
        (view, rule, text, path)
        for view in linted.all_views
        for rule, clause in zip(view.verdict.rules, view.verdict.clauses, strict=True)
        for text in (clause.restriction.conditions if clause.restriction and view.filters else ())
        for path in fields_read(text)
        if view.left(path) is not Precision.EXACT
    )
    for view, rule, text, path in read:
        how = "coarsely" if view.left(path) is Precision.COARSE else "not at all"
        what = f"sees {path} of {view.topic} {how}, but a condition on it tells its value"
        hint = f"remove the condition on {path}, or leave the field as it is"
        message = f"rule {rule.id}: {view.receiver.label} {what}"
        yield LintFinding(rule.line, "condition-tells", message, hint, (Suggestion(rule.id, without=text),))


CHECKS: Final[tuple[Callable[[LintedPolicy], Iterator[LintFinding]], ...]] = (
    reasons_and_times,
    width,
    stale,
    shadowed,
    unused,
    oracles,
    lint_topics.beside_position,
    lint_topics.other_coordinates,
    lint_topics.other_names,
    parameters,
    rates,
    lint_topics.relatives,
    lint_topics.saved_poses,
    lint_topics.unknown,
    lint_topics.second_receivers,
    lint_topics.versions,
    lint_topics.pseudonyms,
    lint_topics.wheels,
    lint_topics.related,
    lint_topics.presence,
    lint_topics.services,
    lint_topics.graph,
)


def lint(policy: Policy, layout_of: LayoutOf) -> list[LintFinding]:
    """All advice on `policy`, in the order of the file, each piece once."""
    linted = LintedPolicy(policy, layout_of)
    return sorted({finding for check in CHECKS for finding in check(linted)})

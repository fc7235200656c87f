"""Advice on a valid policy: what is allowed but unwise.

Precision removed from one field is often still in related fields: a rounded position beside an
exact twist is the exact path again (measured: notes on filters, "what accuracy reduction really
hides"). So a filter is checked together with everything else its receiver gets.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Final

from grants.errors import GrantError
from grants.filters.layout import Layout
from grants.filters.operators import OPERATORS, treatment_for
from grants.model import FilterRule, Right
from grants.policy.decision import Decider
from grants.policy.model import Clause, Effect, Policy, PolicyRule, Subject, SubjectPattern
from grants.policy.privacy import filters_of, leaf_paths

LayoutOf = Callable[[str], Layout]

_ACTING: Final = Right.PUBLISH | Right.CALL | Right.PARAM_SET | Right.ADMIN
_POSITION_FIELDS: Final = {"position", "pose", "point", "translation", "ranges"}
_RELATED_FIELDS: Final = {
    "twist": "the exact path follows from it by integration",
    "linear": "the exact path follows from it by integration",
    "covariance": "it reveals the precision of the hidden value",
    "orientation": "turns reveal the direction of movement",
    "stamp": "the exact time of a cell change reveals the exact position",
    "seq": "counting messages reveals the exact time",
}
_RELATED_TYPES: Final = ("tf2_msgs/TFMessage", "nav_msgs/Odometry", "geometry_msgs/TwistStamped")
_RELATED_NAMES: Final = ("/tf", "/odom")
_LONG: Final = 366 * 86400


@dataclass(frozen=True, order=True)
class Finding:
    """One piece of advice."""

    line: int
    message: str
    hint: str


def lint(policy: Policy, layout_of: LayoutOf) -> list[Finding]:
    """All advice on `policy`, in the order of the file."""
    decider = Decider(policy)
    found: set[Finding] = set()
    for rule in policy.rules:
        found.update(_reasons(policy, rule))
        if rule.effect is not Effect.DENY:
            found.update(_wide(rule))
            found.update(_keep_when_stale(rule))
            found.update(_leaks(decider, rule, layout_of))
    found.update(_unused(policy))
    return sorted(found)


def _reasons(policy: Policy, rule: PolicyRule) -> Iterator[Finding]:
    if not rule.why:
        yield Finding(rule.line, f"rule {rule.id} gives no reason", "add why: ...")
    if rule.effect is Effect.DENY:
        return
    if not rule.has_lifetime and not policy.defaults.has_lifetime:
        hint = "add lifetime: to the rule or to defaults"
        yield Finding(rule.line, f"rule {rule.id} has no lifetime", hint)
    if max(rule.lifetime, rule.renew_until) > _LONG:
        yield Finding(rule.line, f"rule {rule.id} holds for more than a year", "shorten it")


def _wide(rule: PolicyRule) -> Iterator[Finding]:
    for clause in rule.clauses:
        if not (clause.right & _ACTING and "**" in clause.pattern):
            continue
        if all(_owns(who, clause.pattern) for who in rule.who):
            continue
        message = f"rule {rule.id}: {clause.right.label} on {clause.pattern} may move anything"
        yield Finding(rule.line, message, "name the topics and services one by one")


def _keep_when_stale(rule: PolicyRule) -> Iterator[Finding]:
    if rule.keep_when_stale:
        what = ", ".join(sorted({clause.pattern for clause in rule.clauses}))
        message = f"rule {rule.id}: if revocation data is withheld, {what} stays connected"
        yield Finding(
            rule.line,
            message,
            "use on_stale: keep only for what must not stop, as an emergency stop",
        )


def _owns(who: SubjectPattern, pattern: str) -> bool:
    """Whether the names are below the node's own: `/heating/**` of `/heating`."""
    return who.node is not None and pattern.startswith(f"{who.node.removesuffix('/**')}/")


def _leaks(decider: Decider, rule: PolicyRule, layout_of: LayoutOf) -> Iterator[Finding]:
    for clause in rule.clauses:
        restriction = clause.restriction
        if clause.type is None or restriction is None or not restriction.filters:
            continue
        positions = [
            item for item in restriction.filters if _POSITION_FIELDS & set(_steps(item.path))
        ]
        if not positions:
            continue
        yield from _same_message(rule, clause, positions, layout_of(clause.type))
        yield from _other_topics(decider, rule, clause)
        yield from _missing_limits(rule, clause, positions)


def _same_message(
    rule: PolicyRule, clause: Clause, positions: list[FilterRule], layout: Layout
) -> Iterator[Finding]:
    """Unfiltered fields of the same message that reveal the filtered one."""
    assert clause.restriction is not None  # noqa: S101 - checked in `_leaks`
    unfiltered = [
        path for path in leaf_paths(layout) if not filters_of(clause.restriction.filters, path)
    ]
    for name, why in _RELATED_FIELDS.items():
        if paths := [path for path in unfiltered if name in _steps(path)]:
            related = _path_up_to(paths[0], name)
            what = f"{positions[0].path} of {clause.pattern} is filtered, {related}"
            yield Finding(rule.line, f"rule {rule.id}: {what} is not: {why}",
                          f"add {related}: "
                          f"{{{'round: 10' if name == 'stamp' else 'clear: true'}}}")  # fmt: skip


def _other_topics(decider: Decider, rule: PolicyRule, clause: Clause) -> Iterator[Finding]:
    """Related topics that the same receiver gets unfiltered."""
    policy = decider.policy
    related = [topic for topic, kind in policy.types.items() if kind in _RELATED_TYPES]
    same = [topic for topic, kind in policy.types.items() if kind == clause.type]
    for who in rule.who:
        for topic in sorted({*related, *same, *_RELATED_NAMES} - {clause.pattern}):
            verdict = decider.decide(sample_subject(who), Right.SUBSCRIBE, topic)
            if verdict and not any(item.filters for item in verdict.restrictions):
                message = f"rule {rule.id}: {who.label} sees {clause.pattern} coarsely, but {topic}"
                yield Finding(rule.line, f"{message} exactly", f"filter {topic} as well")


def _missing_limits(
    rule: PolicyRule, clause: Clause, positions: list[FilterRule]
) -> Iterator[Finding]:
    rounded = [item for item in positions if item.operator == "round"]
    for item in rounded:
        if "hysteresis" not in dict(item.parameters) and _supports_hysteresis():
            message = f"rule {rule.id}: {item.path} is rounded without hysteresis"
            hint = "add hysteresis: changes at a cell's border reveal the exact position"
            yield Finding(rule.line, message, hint)
    if rounded and clause.rate is None:
        message = f"rule {rule.id}: {clause.pattern} is rounded, but sent at the full rate"
        yield Finding(rule.line, message, "add limit: {rate: 0.2}")


def _supports_hysteresis() -> bool:
    rule = FilterRule("x", "round", (("hysteresis", 0.1), ("step", 1.0)))
    try:
        treatment_for(rule)
    except GrantError:
        return False
    return "round" in OPERATORS


def _unused(policy: Policy) -> Iterator[Finding]:
    used = {who.label for rule in policy.rules for who in (*rule.who, *rule.exceptions)}
    for name in policy.identities.keys() - used:
        yield Finding(0, f"identity {name} is used by no rule", "remove it, or use it")
    filtered = {
        clause.restriction.filters
        for rule in policy.rules
        for clause in rule.clauses
        if clause.restriction is not None
    }
    for name, rules in policy.filters.items():
        if tuple(sorted(rules)) not in filtered:
            yield Finding(0, f"filter {name} is used by no rule", "remove it, or use it")


def sample_subject(who: SubjectPattern) -> Subject:
    """A subject that matches `who`, for trial decisions."""
    node = (who.node or "/x").replace("**", "x").replace("*", "x")
    return Subject(node, who.key or bytes(32))


def _steps(path: str) -> list[str]:
    return path.replace("[*]", "").split(".")


def _path_up_to(path: str, name: str) -> str:
    """The part of `path` up to `name`."""
    steps = path.split(".")
    at = [step.removesuffix("[*]") for step in steps].index(name)
    return ".".join(steps[: at + 1])

"""What is allowed but unwise: advice on a policy that has no mistakes.

Accuracy that is taken from one field is often still in its relatives: a rounded position beside
an exact twist is the exact path again (measured: notes on filters, "what accuracy reduction
really hides"). So a filter is looked at together with everything else its receiver may see.
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
from grants.policy.privacy import leaves, treats

LayoutOf = Callable[[str], Layout]

_ACTING: Final = Right.PUBLISH | Right.CALL | Right.PARAM_SET | Right.ADMIN
_MOVING: Final = {"position", "pose", "point", "translation", "ranges"}
_SECRETS: Final = {
    "twist": "the exact path follows from it by integration",
    "linear": "the exact path follows from it by integration",
    "covariance": "it tells how good the hidden value is",
    "orientation": "turns tell which way somebody goes",
    "stamp": "the exact time of a cell change tells the exact place",
    "seq": "counting messages undoes the rounding of time",
}
_RELATIVES: Final = ("tf2_msgs/TFMessage", "nav_msgs/Odometry", "geometry_msgs/TwistStamped")
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
            found.update(_kept(rule))
            found.update(_leaks(decider, rule, layout_of))
    found.update(_unused(policy))
    return sorted(found)


def _reasons(policy: Policy, rule: PolicyRule) -> Iterator[Finding]:
    if not rule.why:
        yield Finding(rule.line, f"rule {rule.id} gives no reason", "add why: ...")
    if rule.effect is Effect.DENY:
        return
    if not rule.own_lifetime and not policy.defaults.own_lifetime:
        hint = "add lifetime: to the rule or to defaults"
        yield Finding(rule.line, f"rule {rule.id} says no lifetime", hint)
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


def _kept(rule: PolicyRule) -> Iterator[Finding]:
    if rule.keep_when_stale:
        what = ", ".join(sorted({clause.pattern for clause in rule.clauses}))
        message = f"rule {rule.id}: a revocation that is held back leaves {what} connected"
        yield Finding(
            rule.line, message, "keep on_stale for what must not stop, as an emergency stop"
        )


def _owns(who: SubjectPattern, pattern: str) -> bool:
    """Whether the names lie below the node's own: `/heating/**` of `/heating`."""
    return who.node is not None and pattern.startswith(f"{who.node.removesuffix('/**')}/")


def _leaks(decider: Decider, rule: PolicyRule, layout_of: LayoutOf) -> Iterator[Finding]:
    for clause in rule.clauses:
        restriction = clause.restriction
        if clause.type is None or restriction is None or not restriction.filters:
            continue
        moving = [item for item in restriction.filters if _MOVING & set(_steps(item.path))]
        if not moving:
            continue
        yield from _inside(rule, clause, moving, layout_of(clause.type))
        yield from _beside(decider, rule, clause)
        yield from _borders(rule, clause, moving)


def _inside(
    rule: PolicyRule, clause: Clause, moving: list[FilterRule], layout: Layout
) -> Iterator[Finding]:
    """Fields of the same message that tell what was taken."""
    assert clause.restriction is not None  # noqa: S101 - `_leaks` looked
    open_ = [path for path in leaves(layout) if not treats(clause.restriction.filters, path)]
    for word, why in _SECRETS.items():
        if paths := [path for path in open_ if word in _steps(path)]:
            what = f"{moving[0].path} of {clause.pattern} is filtered, {_above(paths[0], word)}"
            yield Finding(rule.line, f"rule {rule.id}: {what} is not: {why}",
                          f"add {_above(paths[0], word)}: "
                          f"{{{'round: 10' if word == 'stamp' else 'clear: true'}}}")  # fmt: skip


def _beside(decider: Decider, rule: PolicyRule, clause: Clause) -> Iterator[Finding]:
    """Other topics the same receiver sees exactly."""
    policy = decider.policy
    related = [topic for topic, kind in policy.types.items() if kind in _RELATIVES]
    same = [topic for topic, kind in policy.types.items() if kind == clause.type]
    for who in rule.who:
        for topic in sorted({*related, *same, *_RELATED_NAMES} - {clause.pattern}):
            verdict = decider.decide(sample_subject(who), Right.SUBSCRIBE, topic)
            if verdict and not any(item.filters for item in verdict.restrictions):
                message = f"rule {rule.id}: {who.label} sees {clause.pattern} coarsely, but {topic}"
                yield Finding(rule.line, f"{message} exactly", f"filter {topic} as well")


def _borders(rule: PolicyRule, clause: Clause, moving: list[FilterRule]) -> Iterator[Finding]:
    rounded = [item for item in moving if item.operator == "round"]
    for item in rounded:
        if "hysteresis" not in dict(item.parameters) and _knows_hysteresis():
            message = f"rule {rule.id}: {item.path} is rounded without hysteresis"
            hint = "add hysteresis: flips at a cell's border tell the exact place"
            yield Finding(rule.line, message, hint)
    if rounded and clause.rate is None:
        message = f"rule {rule.id}: {clause.pattern} is rounded, but comes at the full rate"
        yield Finding(rule.line, message, "add limit: {rate: 0.2}")


def _knows_hysteresis() -> bool:
    rule = FilterRule("x", "round", (("hysteresis", 0.1), ("step", 1.0)))
    try:
        treatment_for(rule)
    except GrantError:
        return False
    return "round" in OPERATORS


def _unused(policy: Policy) -> Iterator[Finding]:
    used = {who.label for rule in policy.rules for who in (*rule.who, *rule.exceptions)}
    for name in policy.identities.keys() - used:
        yield Finding(0, f"identity {name} is used by no rule", "take it out, or use it")
    filtered = {
        clause.restriction.filters
        for rule in policy.rules
        for clause in rule.clauses
        if clause.restriction is not None
    }
    for name, rules in policy.filters.items():
        if tuple(sorted(rules)) not in filtered:
            yield Finding(0, f"filter {name} is used by no rule", "take it out, or use it")


def sample_subject(who: SubjectPattern) -> Subject:
    """Somebody a rule is for, to try out decisions with."""
    node = (who.node or "/x").replace("**", "x").replace("*", "x")
    return Subject(node, who.key or bytes(32))


def _steps(path: str) -> list[str]:
    return path.replace("[*]", "").split(".")


def _above(path: str, word: str) -> str:
    """The part of `path` up to `word`."""
    steps = path.split(".")
    at = [step.removesuffix("[*]") for step in steps].index(word)
    return ".".join(steps[: at + 1])

"""Advice on rules as such: reasons, lifetimes, width, names of others, what never decides."""

from collections.abc import Iterable, Iterator
from typing import Final

from ca.domains.aliases import is_alias
from grants.model import Right
from grants.policy.lint_findings import Finding, Suggestion
from grants.policy.lint_views import Scene
from grants.policy.model import Clause, Effect, PolicyRule, SubjectPattern
from grants.policy.own_names import NODE, any_node, is_own, speaks_for_others
from grants.policy.patterns import gives, includes, intersects

_ACTING: Final = Right.PUBLISH | Right.CALL | Right.PARAM_SET | Right.ADMIN
_SPEAKING: Final = Right.PUBLISH | Right.PROVIDE | Right.PARAM_SET
_LONG: Final = 366 * 86400


def reasons_and_times(scene: Scene) -> Iterator[Finding]:
    """Rules without a reason, and with no lifetime or a long one."""
    for rule in scene.policy.rules:
        if not rule.why:
            yield _of(rule, "no-reason", "gives no reason", "add why: ...")
        if rule.effect is Effect.DENY:
            continue
        if not rule.has_lifetime and not scene.policy.defaults.has_lifetime:
            hint = "add lifetime: to the rule or to defaults"
            yield _of(rule, "no-lifetime", "has no lifetime", hint)
        if max(rule.lifetime, rule.renew_until) > _LONG:
            yield _of(rule, "long-lifetime", "holds for more than a year", "shorten it")


def width(scene: Scene) -> Iterator[Finding]:
    """Rights to act on more than the own names."""
    for rule in _giving(scene):
        for clause in rule.clauses:
            if all(_owns(who, clause.pattern) for who in rule.who):
                continue
            what = f"{clause.right.label} on {clause.pattern}"
            if clause.right & _ACTING and "**" in clause.pattern:
                hint = "name the topics and services one by one"
                yield _of(rule, "wide-right", f"{what} may move anything", hint, ": ")
            elif clause.right & _SPEAKING and "*" in clause.pattern and _are_many(rule.who):
                yield _for_others(rule, clause, what)


def _for_others(rule: PolicyRule, clause: Clause, what: str) -> Finding:
    message = f"with {what} each of {rule.subjects_text} can act for the others"
    own = _own_names(rule, clause.pattern)
    if own is None:
        hint = "give each node its own names, in a rule of its own"
        return _of(rule, "speaks-for-others", message, hint, ": ")
    change = Suggestion(rule.id, clause.pattern, instead=own)
    return _of(rule, "speaks-for-others", message, f'write "{own}"', ": ", (change,))


def _own_names(rule: PolicyRule, pattern: str) -> str | None:
    """What was meant: `{node}/pose`, if the pattern is that of the nodes and a name below it."""
    nodes = [who.node for who in rule.who]
    if len(nodes) == 1 and nodes[0] is not None and pattern.startswith(f"{nodes[0]}/"):
        return NODE + pattern.removeprefix(nodes[0])
    return speaks_for_others(pattern, nodes)


def _owns(who: SubjectPattern, pattern: str) -> bool:
    """Whether the names are below the node's own: `/heating/**` of `/heating`."""
    if is_own(pattern):
        return True
    base = (who.node or "*").removesuffix("/**")
    return "*" not in base and pattern.startswith(f"{base}/")


def _are_many(who: Iterable[SubjectPattern]) -> bool:
    nodes = {each.node for each in who if each.node is not None}
    return len(nodes) > 1 or any("*" in node for node in nodes)


def stale(scene: Scene) -> Iterator[Finding]:
    """Connections that outlive withheld revocation data."""
    for rule in _giving(scene):
        if rule.keep_when_stale:
            what = ", ".join(sorted({clause.pattern for clause in rule.clauses}))
            message = f"if revocation data is withheld, {what} stays connected"
            hint = "use on_stale: keep only for what must not stop, as an emergency stop"
            yield _of(rule, "keep-when-stale", message, hint, ": ")


def shadowed(scene: Scene) -> Iterator[Finding]:
    """Rights that another rule always denies, and prompts that are always allowed."""
    denials = [rule for rule in scene.policy.rules if rule.effect is Effect.DENY]
    allowing = [rule for rule in scene.policy.rules if rule.effect is Effect.ALLOW]
    for rule in _giving(scene):
        stronger = [*denials, *(allowing if rule.effect is Effect.PROMPT else ())]
        for clause in rule.clauses:
            for other in stronger:
                if _always_decides(other, rule, clause):
                    verb = "denied" if other.effect is Effect.DENY else "allowed"
                    what = f"{clause.right.label} {clause.pattern} never applies"
                    message = f"{what}: it is always {verb} by rule {other.id}"
                    yield _of(
                        rule, "never-decides", message, "remove it, or narrow the other", ": "
                    )
                    break


def _always_decides(other: PolicyRule, rule: PolicyRule, clause: Clause) -> bool:
    """Whether `other`, of a stronger effect, decides wherever `clause` of `rule` matches."""
    covered = any(
        each.right is clause.right and _gives(each.pattern, clause.right, clause.pattern)
        for each in other.clauses
    )
    return covered and all(_applies_to_all(other, who) for who in rule.who)


def _gives(pattern: str, right: Right, requested: str) -> bool:
    if is_own(pattern):
        return pattern == requested
    return gives(pattern, right, any_node(requested))


def _applies_to_all(rule: PolicyRule, who: SubjectPattern) -> bool:
    if any(_may_be_of(each, who) for each in rule.exceptions):
        return False
    return any(_is_wider(each, who) for each in rule.who)


def _may_be_of(one: SubjectPattern, other: SubjectPattern) -> bool:
    """Whether some node may be both."""
    if one.key is not None and other.key is not None and one.key != other.key:
        return False
    return one.node is None or other.node is None or intersects(one.node, other.node)


def _is_wider(one: SubjectPattern, other: SubjectPattern) -> bool:
    """Whether every node of `other` is certainly one of `one`."""
    if one.key is not None and one.key != other.key:
        return False
    if is_alias(other.node or "") and not is_alias(one.node or ""):
        return False  # a foreign node is meant only where its domain is named
    return one.node is None or (other.node is not None and includes(one.node, other.node))


def unused(scene: Scene) -> Iterator[Finding]:
    """Identities, groups, filters and types that no rule uses."""
    policy = scene.policy
    used = {who.label for rule in policy.rules for who in (*rule.who, *rule.exceptions)}
    for name in sorted(policy.identities.keys() - used):
        message = f"identity {name} is used by no rule"
        yield Finding(0, "unused-identity", message, "remove it, or use it")
    for name in policy.unused_groups:
        message = f"group {name} is used by no rule"
        yield Finding(0, "unused-group", message, "remove it, or use it")
    clauses = [clause for rule in policy.rules for clause in rule.clauses]
    filtered = {clause.restriction.filters for clause in clauses if clause.restriction is not None}
    for name, rules in policy.filters.items():
        if tuple(sorted(rules)) not in filtered:
            message = f"filter {name} is used by no rule"
            yield Finding(0, "unused-filter", message, "remove it, or use it")
    yield from _unused_types(policy.types, {clause.pattern for clause in clauses})


def _unused_types(types: Iterable[str], named: set[str]) -> Iterator[Finding]:
    names = {any_node(pattern) for pattern in named}
    wide = [pattern for pattern in names if "*" in pattern]
    for topic in types:
        name = any_node(topic)
        below = any(includes(pattern, name) for pattern in wide)
        above = "*" in name and any(includes(name, each) for each in names)
        if name not in names and not below and not above:
            message = f"the type of {topic} is used by no rule"
            yield Finding(0, "unused-type", message, "remove it, or correct the name")


def _giving(scene: Scene) -> Iterator[PolicyRule]:
    """The rules that allow or prompt."""
    return (rule for rule in scene.policy.rules if rule.effect is not Effect.DENY)


def _of(
    rule: PolicyRule, code: str, message: str, hint: str, joint: str = " ",
    suggestions: tuple[Suggestion, ...] = (),
) -> Finding:  # fmt: skip
    return Finding(rule.line, code, f"rule {rule.id}{joint}{message}", hint, suggestions)

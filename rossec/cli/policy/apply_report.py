"""The difference between a policy and the grants in force, as text and as JSON.

What is the same for many nodes is one line of text. JSON has each right of each node.
"""

from collections.abc import Iterable, Iterator

from ca.domains.aliases import shown
from ca.revocation.lists import MAX_ENTRIES
from grants.policy.basics import is_basics
from grants.policy.changes import Change, Kind
from grants.policy.difference import Contradiction
from grants.policy.model import Effect, PolicyRule
from grants.policy.wanted import Withheld
from rossec.authority.policy_plan import PolicyPlan
from rossec.clock import format_time
from rossec.terminal import printable

_NAMED = 3  # nodes of one line
_NONE = "no rule allows it any more"


def lines(plan: PolicyPlan) -> Iterator[str]:
    """The plan as text, for people."""
    changes = [change for node in plan.nodes for change in node.changes]
    yield from _by_nodes(
        (shown(change.subject.name), _change(change))
        for change in changes
        if change.kind != Kind.KEPT
    )
    kept = {change.subject for change in changes if change.kind is Kind.KEPT}
    if kept:
        rights = sum(change.kind is Kind.KEPT for change in changes)
        yield f"= {count(rights, 'right')} of {count(len(kept), 'node')} as before"
    yield from _by_nodes(
        (shown(node.subject.name), _withheld(each)) for node in plan.nodes for each in node.withheld
    )
    yield from _by_nodes(
        (each.grant.subject, _contradiction(each, pruned=plan.options.prune))
        for node in plan.nodes
        for each in node.contradictions
    )
    yield from _outlook(plan)


def summary(plan: PolicyPlan) -> str:
    """What would be done: `sign 3 grants and revoke 1 grant`."""
    signs, revokes = plan.signs, len(plan.revoke)
    parts = [f"sign {count(signs, 'grant')}"] if signs else []
    parts += [f"revoke {count(revokes, 'grant')}"] if revokes else []
    return " and ".join(parts)


def count(number: int, what: str) -> str:
    """`1 grant`, `2 grants`."""
    return f"{number} {what}" if number == 1 else f"{number} {what}s"


def as_json(plan: PolicyPlan) -> dict[str, object]:
    """The plan for programs."""
    return {
        "policy": str(plan.policy.path),
        "changes": [_change_row(each) for node in plan.nodes for each in node.changes],
        "withheld": [
            {"node": shown(node.subject.name), "right": each.right.label, "name": each.pattern,
             "effect": each.effect, "rule": _rule_row(each.rule), "by": _rule_row(each.by)}
            for node in plan.nodes for each in node.withheld
        ],
        "contradictions": [
            {"node": each.grant.subject, "right": each.right.label, "name": each.pattern,
             "grant": each.grant.id.hex(), "rule": _rule_row(each.rule)}
            for node in plan.nodes for each in node.contradictions
        ],
        "refused": list(plan.refused),
        "due": [grant.id.hex() for node in plan.nodes for grant in node.due],
        "sign": plan.signs,
        "revoke": [grant.id.hex() for grant in plan.revoke],
        "listed": plan.listed,
        "ends": plan.ends,
    }  # fmt: skip


def _outlook(plan: PolicyPlan) -> Iterator[str]:
    for reason in plan.refused:
        yield printable(f"! {reason}")
    if plan.is_empty and not plan.refused:
        yield "the policy is in force, nothing to do"
    if plan.needs_tree:
        yield (
            f"the revocations are a tree of {plan.listed} entries: a list has at most {MAX_ENTRIES}"
        )
    due = sum(len(node.due) for node in plan.nodes)
    if due:
        yield f"{count(due, 'grant')} due for renewal: rossec policy apply --renew"
    if plan.ends is not None:
        yield f"the first grant of the policy ends {format_time(plan.ends)}"


def _by_nodes(rows: Iterable[tuple[str, tuple[str, str]]]) -> Iterator[str]:
    """One line for each text, with the nodes it is about after its first sign."""
    nodes: dict[tuple[str, str], dict[str, None]] = {}
    for node, signed_text in rows:
        nodes.setdefault(signed_text, {})[node] = None
    for (sign, text), each in nodes.items():
        names = [*each]
        named = ", ".join(names[:_NAMED])
        more = f" and {count(len(names) - _NAMED, 'more node')}" if len(names) > _NAMED else ""
        yield printable(f"{sign} {named}{more}: {text}")


def _change(change: Change) -> tuple[str, str]:
    what = f"{change.right.label} {change.pattern}"
    if change.rules and all(map(is_basics, change.rules)):
        what = "what every ROS program needs"
    if change.kind is Kind.GONE:
        return "-", f"{what} ({_rules(change.rules) or _NONE})"
    restrictions = "; ".join(change.restrictions)
    rules = f"({_rules(change.rules)})"
    if change.kind is Kind.NEW:
        return "+", f"{what}, {restrictions} {rules}"
    before = "; ".join(change.before)
    return "~", f"{change.kind}: {what}, {restrictions} {rules}; before: {before}"


def _withheld(each: Withheld) -> tuple[str, str]:
    what = f"{each.right.label} {each.pattern}"
    if each.effect is Effect.PROMPT:
        return "?", f"{what} waits for a request and a person ({_rule(each.rule)})"
    denied = f"is not granted: {_rule(each.by)} denies some of it"
    return "!", f"{what} ({_rule(each.rule)}) {denied}; write the rule for narrower names"


def _contradiction(each: Contradiction, *, pruned: bool) -> tuple[str, str]:
    grant = f"grant {each.grant.short_id}, made by hand"
    what = f"{each.right.label} {each.pattern} by {grant}"
    return "-" if pruned else "!", f"{what}, against the denial of {_rule(each.rule)}"


def _rules(rules: Iterable[PolicyRule]) -> str:
    return ", ".join(_rule(rule) for rule in rules)


def _rule(rule: PolicyRule) -> str:
    return f"rule {rule.id}, line {rule.line}"


def _rule_row(rule: PolicyRule) -> dict[str, object]:
    return {"id": rule.id, "line": rule.line, "why": rule.why}


def _change_row(change: Change) -> dict[str, object]:
    return {
        "sign": change.kind.sign,
        "kind": str(change.kind),
        "node": shown(change.subject.name),
        "right": change.right.label,
        "name": change.pattern,
        "restrictions": list(change.restrictions),
        "before": list(change.before),
        "rules": [_rule_row(rule) for rule in change.rules],
    }

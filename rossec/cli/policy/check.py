"""`rossec policy check | lint | init | import-sros2 | test`, and what a policy changes in grants."""

from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

import click

from ca.names import shown
from ca.revocation.lists import MAX_ENTRIES
from grants.errors import PolicyRefused
from grants.policy.assertion_check import CheckOutcome, check_tests
from grants.policy.difference import Change, ChangeKind, Contradiction
from grants.policy.learn import beginning
from grants.policy.lint import lint as advise
from grants.policy.model import Effect, PolicyRule
from grants.policy.read import mistakes_in
from grants.policy.rules import is_basics
from grants.policy.source import Mistake
from grants.policy.sros2 import MAX_SIZE, described, import_sros2
from grants.policy.wanted import Withheld
from rossec import clock, files
from rossec.authority.policyfile import PolicyFile, PolicyPlan, parse_policy, place
from rossec.cli.shared import options
from rossec.cli.shared.context import Environment, pass_environment
from rossec.errors import ConfigurationError
from rossec.participant.host_types import layout_of
from rossec.terminal import fail, note, printable, say, say_block, say_json

_NAMED = 3  # nodes of one line


@click.command()
@click.argument("file", required=False, type=options.PATH)
@options.option("--robot", "its name, for people  [default: home]", default="home")
@options.json_result(pass_environment)
def init(environment: Environment, file: Path | None, robot: str) -> None:
    """Write the commented beginning of a policy to FILE, which must not exist.

    It gives every node what every ROS program needs (`basics`), and nothing else.
    """
    path = place(environment.home, file)
    if not path.parent.is_dir():
        raise ConfigurationError(
            f"there is no {path.parent}", "name a file, or create an authority: rossec ca init DOMAIN"
        )
    text = beginning(robot)
    parse_policy(text, str(path))
    files.create(path, text.encode(), 0o644)
    say(f"{path} is begun; write rules, then: rossec policy check {path}", file=str(path))


@click.command("import-sros2")
@click.argument("xml", type=options.FILE)
@options.option("--out", "write the policy to this new file", type=options.PATH)
def import_(xml: Path, out: Path | None) -> None:
    """Turn the SROS2 policy in XML into one of rossec.

    What it allows and does not fit is left out, and said; what it denies is kept, or it is refused.
    """
    data = files.read(xml, 4 * MAX_SIZE)
    try:
        text, notes = import_sros2(data.decode(errors="replace"))
    except PolicyRefused as error:
        for mistake in error.mistakes:
            note(str(mistake))
        raise
    parse_policy(text, str(xml))
    for line in notes:
        note(described(line))
    if out is None:
        say_block(text.rstrip())
        return
    files.create(out, text.encode(), 0o644)
    say(f"written to {out}")


@click.command()
@click.argument("file", required=False, type=options.FILE)
@options.as_json
@pass_environment
def check(environment: Environment, file: Path | None, as_json: bool) -> None:
    """Check the policy in FILE: its form, its words, conditions and filters, and its tests."""
    path = place(environment.home, file)
    try:
        read = PolicyFile.read(path)
    except PolicyRefused as error:
        _print_mistakes(mistakes_in(error), as_json=as_json)
        raise PolicyRefused(f"{path} is not a policy", "correct it, and check again") from None
    outcomes = check_tests(read.policy, layout_of)
    failures = [each for each in outcomes if not each]
    if failures:
        found = (Mistake(x.line, 1, x.failure, x.needed, str(path)) for x in failures)
        _print_mistakes(tuple(found), as_json=as_json)
        raise _not_held(failures, len(outcomes), path)
    basics = any(map(is_basics, read.policy.rules))
    rules = [f"rules: {len(read.policy.rules) - basics}", *(["basics"] if basics else [])]
    tests = [f"tests that hold: {len(read.policy.tests)}"] if read.policy.tests else []
    options.say_result(as_json, [], [f"{path} is right; {', '.join([*rules, *tests])}"])


def _not_held(failures: Sequence[CheckOutcome], total: int, path: Path) -> PolicyRefused:
    message = f"{len(failures)} of {total} assertions of {path} do not hold"
    return PolicyRefused(message, "correct the rules, or what the tests say")


def _print_mistakes(found: tuple[Mistake, ...], *, as_json: bool) -> None:
    if as_json:
        say_json([vars(item) for item in found])
        return
    for item in found:
        fail(str(item), item.hint)


def as_json(plan: PolicyPlan) -> dict[str, object]:
    return {
        "policy": str(plan.policy.path),
        "changes": [
            {
                "sign": each.kind.sign,
                "kind": str(each.kind),
                "node": shown(each.subject.name),
                "right": each.right.label,
                "name": each.pattern,
                "restrictions": list(each.restrictions),
                "before": list(each.before),
                "rules": [_rule_row(rule) for rule in each.rules],
            }
            for node in plan.nodes
            for each in node.changes
        ],
        "withheld": [
            {
                "node": shown(node.subject.name),
                "right": each.right.label,
                "name": each.pattern,
                "effect": each.effect,
                "rule": _rule_row(each.rule),
                "by": _rule_row(each.by),
            }
            for node in plan.nodes
            for each in node.withheld
        ],
        "contradictions": [
            {
                "node": each.grant.subject,
                "right": each.right.label,
                "name": each.pattern,
                "grant": each.grant.id.hex(),
                "rule": _rule_row(each.rule),
            }
            for node in plan.nodes
            for each in node.contradictions
        ],
        "refused": list(plan.refused),
        "due": [grant.id.hex() for node in plan.nodes for grant in node.due],
        "sign": plan.signs,
        "revoke": [grant.id.hex() for grant in plan.revoke],
        "listed": plan.listed,
        "ends": plan.ends,
    }


def _rule_row(rule: PolicyRule) -> dict[str, object]:
    return {"id": rule.id, "line": rule.line, "why": rule.why}


@click.command()
@click.argument("file", required=False, type=options.FILE)
@options.as_json
@pass_environment
def lint(environment: Environment, file: Path | None, as_json: bool) -> None:
    """Warn of what the policy in FILE allows unwisely, such as a hidden value that still leaks."""
    read = PolicyFile.read(place(environment.home, file))
    found = advise(read.policy, layout_of)

    def lines() -> Iterator[str]:
        for item in found:
            yield f"{read.path}:{item.line}: {item.message} [{item.code}]"
            yield f"  {item.hint}"
        yield remarks(len(found))

    options.say_result(as_json, [item.as_json() for item in found], lines())


def remarks(number: int) -> str:
    return count(number, "remark") if number else "nothing to remark"


def count(number: int, what: str) -> str:
    """`1 grant`, `2 grants`."""
    return f"{number} {what}" if number == 1 else f"{number} {what}s"


@click.command()
@click.argument("file", required=False, type=options.FILE)
@options.flag("--json as_json", "one line of JSON")
@pass_environment
def test(environment: Environment, file: Path | None, as_json: bool) -> None:
    """Run the tests in the policy FILE: what must stay true of it.

    Each failure says which rule decided, and what would be needed. `rossec policy apply` refuses a
    policy of which one fails.
    """
    path = place(environment.home, file)
    outcomes = check_tests(PolicyFile.read(path).policy, layout_of)
    if as_json:
        say_json([_row(each) for each in outcomes])
    failures = [each for each in outcomes if not each]
    for each in failures if not as_json else ():
        fail(f"{path}:{each.line}: {each.failure}", each.needed)
    if failures:
        raise _not_held(failures, len(outcomes), path)
    if not as_json:
        say(f"assertions that hold: {len(outcomes)}" if outcomes else f"{path} has no tests")


def _row(outcome: CheckOutcome) -> dict[str, object]:
    return {
        "line": outcome.line,
        "node": outcome.node,
        "says": outcome.says,
        "holds": bool(outcome),
        "failure": outcome.failure,
        "rules": list(outcome.rules),
        "needed": outcome.needed,
    }


def lines(plan: PolicyPlan) -> Iterator[str]:
    # 1. What is new, narrower, wider or no longer allowed; what stays is counted.
    changes = [change for node in plan.nodes for change in node.changes]
    yield from _by_nodes(
        (shown(change.subject.name), _change(change)) for change in changes if change.kind != ChangeKind.KEPT
    )
    kept = {change.subject for change in changes if change.kind is ChangeKind.KEPT}
    if kept:
        rights = sum(change.kind is ChangeKind.KEPT for change in changes)
        yield f"= {count(rights, 'right')} of {count(len(kept), 'node')} as before"
    # 2. What the policy allows and no grant can say, and what grants by hand allow against it.
    yield from _by_nodes(
        (shown(node.subject.name), _withheld(each)) for node in plan.nodes for each in node.withheld
    )
    sign = "-" if plan.options.prune else "!"
    against = [each for node in plan.nodes for each in node.contradictions]  # also what is pruned
    yield from _by_nodes((each.grant.subject, (sign, _against(each))) for each in against)
    # 3. What comes next.
    for reason in plan.refused:
        yield printable(f"! {reason}")
    if plan.is_empty and not plan.refused:
        yield "the policy is in force, nothing to do"
    if plan.needs_tree:
        yield (f"the revocations are a tree of {plan.listed} entries: a list has at most {MAX_ENTRIES}")
    due = sum(len(node.due) for node in plan.nodes)
    if due:
        yield f"{count(due, 'grant')} due for renewal: rossec policy apply --renew"
    if plan.ends is not None:
        yield f"the first grant of the policy ends {clock.format_time(plan.ends)}"


# What is the same for many nodes is one line of text; JSON has each right of each node.
def _by_nodes(rows: Iterable[tuple[str, tuple[str, str]]]) -> Iterator[str]:
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
    if change.kind is ChangeKind.GONE:
        return "-", f"{what} ({_rules(change.rules) or 'no rule allows it any more'})"
    restrictions = "; ".join(change.restrictions)
    rules = f"({_rules(change.rules)})"
    if change.kind is ChangeKind.NEW:
        return "+", f"{what}, {restrictions} {rules}"
    before = "; ".join(change.before)
    return "~", f"{change.kind}: {what}, {restrictions} {rules}; before: {before}"


def _rules(rules: Iterable[PolicyRule]) -> str:
    return ", ".join(rule.cited for rule in rules)


def _withheld(each: Withheld) -> tuple[str, str]:
    what = f"{each.right.label} {each.pattern}"
    if each.effect is Effect.PROMPT:
        return "?", f"{what} waits for a request and a person ({each.rule.cited})"
    denied = f"is not granted: {each.by.cited} denies some of it"
    return "!", f"{what} ({each.rule.cited}) {denied}; write the rule for narrower names"


def _against(each: Contradiction) -> str:
    grant = f"grant {each.grant.short_id}, made by hand"
    return f"{each.right.label} {each.pattern} by {grant}, against the denial of {each.rule.cited}"


def summary(plan: PolicyPlan) -> str:
    """What would be done: `sign 3 grants and revoke 1 grant`."""
    signs, revokes = plan.signs, len(plan.revoke)
    parts = [f"sign {count(signs, 'grant')}"] if signs else []
    parts += [f"revoke {count(revokes, 'grant')}"] if revokes else []
    return " and ".join(parts)

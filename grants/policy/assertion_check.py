"""Whether the tests of a policy hold: each claim decided as requests are, each field tried. Pure.

A failure names the rule that decided, with its line, and what would be needed. What cannot be
evaluated, such as a field that a type does not have, fails: a test that tests nothing would pass.
"""

import struct
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace

from ca.domains.aliases import is_alias, shown
from ca.names import covers as names_cover
from ca.patterns import covers
from grants.conditions.compile import compile_condition
from grants.errors import GrantError, PolicyRefused
from grants.filters.layout import Layout
from grants.model import TREE_RIGHTS, Right
from grants.policy.assertions import EXACT, NOTHING, Assertion, Claim, Says, SeenField
from grants.policy.basics import is_basics
from grants.policy.decision import Decider, Verdict
from grants.policy.index import is_pattern
from grants.policy.model import Clause, Effect, Policy, PolicyRule, Subject, SubjectPattern
from grants.policy.own_names import is_own, resolve
from grants.policy.patterns import gives, overlaps
from grants.policy.sample_messages import leaves, serialize
from grants.policy.seen_check import seen_too_well
from grants.validity import format_time

LayoutOf = Callable[[str], Layout]


@dataclass(frozen=True)
class Outcome:
    """Of one claim, or of one field.

    Args:
        says: what was asserted, for people.
        failure: why it does not hold; empty: it does.
        rules: the deciding rules by id.
        needed: what would be needed.
    """

    line: int
    node: str
    says: str
    failure: str = ""
    rules: tuple[str, ...] = ()
    needed: str = ""

    def __bool__(self) -> bool:
        return not self.failure


def check_tests(policy: Policy, layout_of: LayoutOf) -> list[Outcome]:
    """The outcome of every test of `policy`, in the order of the file."""
    checker = _Checker(policy, layout_of)
    return [outcome for each in policy.tests for outcome in checker.outcomes(each)]


def require_tests(policy: Policy, layout_of: LayoutOf) -> None:
    """Return if every test of `policy` holds.

    Raises:
        PolicyRefused: with the first failure.
    """
    failures = [each for each in check_tests(policy, layout_of) if not each]
    if failures:
        first = failures[0]
        count = f" (and {len(failures) - 1} more)" if len(failures) > 1 else ""
        raise PolicyRefused(
            f"{policy.file}:{first.line}: the test does not hold: {first.failure}{count}",
            "see: rossec policy test; correct the rule, or the test",
        )


class _Checker:
    def __init__(self, policy: Policy, layout_of: LayoutOf) -> None:
        self._policy = policy
        self._decider = Decider(policy)
        self._layout_of = layout_of

    def outcomes(self, test: Assertion) -> Iterator[Outcome]:
        for claim in test.claims:
            checks = self._variants(test) if claim.says is Says.MAY_NOT else [test]
            yield _first_failure(self._claim(each, claim) for each in checks)
        for seen in test.seen:
            first, *others = self._variants(test)
            allowed = (
                each
                for each in others
                if self._decider.decide(each.subject, Right.SUBSCRIBE, seen.topic)
            )
            yield _first_failure(self._seen(each, seen) for each in (first, *allowed))

    def _variants(self, test: Assertion) -> list[Assertion]:
        """The test about all who may be its node: what must not be may be for none of them.

        The node itself first; then with each key that a rule pins for it or for any node, with a
        wildcard tail, and of a pattern each node of it that a rule names.
        """
        subject = test.subject
        rules = self._policy.rules
        named = [who for rule in rules for who in (*rule.who, *rule.exceptions)]
        exact = [who.node for who in named if who.node and "*" not in who.node]
        others = {*exact, *(each.subject.name for each in self._policy.tests)}
        names = [node for node in exact if test.pattern and covers(test.pattern, node)]
        found = {
            Subject(name, key, tail): None
            for name in (subject.name, *names)
            for key in (subject.key, *_keys_of(named, name, subject))
            for tail in (False, True)
            if not (tail and (is_alias(name) or _is_one_node(name, others)))
        }
        return [replace(test, subject=each) for each in found]

    def _claim(self, test: Assertion, claim: Claim) -> Outcome:
        node, what = _shown(test.subject), f"{claim.right.label} {claim.name}"
        says = f"{claim.says.replace('_', ' ')} {what}"
        verdict = self._decider.decide(test.subject, claim.right, claim.name)
        try:
            failure, needed = self._refuted(test, claim, verdict)
        except (GrantError, ValueError, struct.error, OverflowError) as error:
            failure, needed = f"{what} cannot be tried: {error}", "correct the test"
        rules = tuple(dict.fromkeys(rule.id for rule in verdict.rules))
        return Outcome(claim.line, node, says, failure and f"{node} {failure}", rules, needed)

    def _refuted(self, test: Assertion, claim: Claim, verdict: Verdict) -> tuple[str, str]:
        """Why the claim does not hold, and what would be needed; empty if it holds."""
        what = f"{claim.right.label} {claim.name}"
        wanted = {Says.MAY: Effect.ALLOW, Says.MAY_NOT: Effect.DENY, Says.ASKS: Effect.PROMPT}
        is_whole = is_pattern(verdict.name) or (not verdict and claim.right & TREE_RIGHTS)
        if claim.says is Says.MAY_NOT and is_whole:
            return self._some_allowed(test.subject, claim)
        if claim.says is Says.MAY_NOT and verdict and test.at:
            open_at = [now for now in test.at if not self._closed(verdict, test, now)]
            if not open_at:
                return "", ""
            when = f" at {format_time(open_at[0])}"
            return f"may {what}{when}: {_decided(verdict)}", self._changes(verdict)
        if verdict.effect is not wanted[claim.says]:
            return f"{_EFFECTS[verdict.effect]} {what}: {_decided(verdict)}", self._changes(verdict)
        for now in test.at if claim.says is Says.MAY else ():
            closed = self._closed(verdict, test, now)
            if closed:
                needed = "change the condition, or the time of the test"
                return f"may not {what} at {format_time(now)}: not true: {closed}", needed
        return "", ""

    def _some_allowed(self, subject: Subject, claim: Claim) -> tuple[str, str]:
        """The first rule that gives a name of the pattern, or a parameter below or above the name.

        No part of it may be given: who sets /safety/max_speed has set a part of /safety.
        """
        name = claim.name
        if is_own(name):
            own = resolve(name, subject.name, tail=subject.tail)
            if own is None:
                return "", ""
            name = own
        rules = self._decider.rules_of(subject)
        denied = [
            clause.pattern
            for rule in rules if rule.effect is Effect.DENY
            for clause in _clauses(rule, subject, claim.right)
        ]  # fmt: skip
        for rule in rules:
            if rule.effect is Effect.DENY or (is_basics(rule) and is_pattern(name)):
                continue
            for clause in _clauses(rule, subject, claim.right):
                common = overlaps(clause.pattern, claim.right, name)
                covered = any(
                    gives(no, claim.right, each) for no in denied for each in (clause.pattern, name)
                )
                if common and not covered:
                    may = _EFFECTS[rule.effect]
                    failure = f"{may} {claim.right.label} {clause.pattern}: {_named(rule)}"
                    return failure, f"take {clause.pattern} out of {rule.id}, or deny it"
        default = self._policy.defaults.decision
        if default is not Effect.DENY and not any(gives(no, claim.right, name) for no in denied):
            failure = f"{_EFFECTS[default]} {claim.right.label} {name}: {_BY_DEFAULT}"
            return failure, f"a deny rule with {claim.right.label}: [{claim.name}]"
        return "", ""

    def _closed(self, verdict: Verdict, test: Assertion, now: int) -> str:
        """The first condition that is not true then; empty if all are."""
        for restriction in verdict.restrictions:
            layout, message = None, b""
            if restriction.type is not None:
                layout = self._layout_of(restriction.type)
                unknown = test.message.keys() - leaves(layout).keys()
                if unknown:
                    raise PolicyRefused(f"{restriction.type} has no field {min(unknown)!r}")
                message = serialize(layout, test.message)
            for text in restriction.conditions:
                if compile_condition(layout, text)(message, now) is not True:
                    return text
        return ""

    def _changes(self, verdict: Verdict) -> str:
        return "; ".join(self._decider.changes(verdict))

    def _seen(self, test: Assertion, seen: SeenField) -> Outcome:
        node = shown(test.subject.name)
        says = f"sees {seen.path} of {seen.topic}: {_limit(seen)}"
        verdict = self._decider.decide(test.subject, Right.SUBSCRIBE, seen.topic)
        rules = tuple(dict.fromkeys(rule.id for rule in verdict.rules))
        if not verdict:
            failure = f"{node} may not subscribe {seen.topic}: {_decided(verdict)}"
            needed = f"if it is to see nothing, write {seen.topic}: {NOTHING}"
            return Outcome(seen.line, node, says, failure, rules, needed)
        try:
            found = seen_too_well(self._policy, self._layout_of, verdict, seen)
        except GrantError as error:
            failure = f"{node}: {seen.path} of {seen.topic} cannot be tried: {error}"
            return Outcome(seen.line, node, says, failure, rules, error.hint or "correct the test")
        if not found:
            return Outcome(seen.line, node, says, "", rules)
        failure = f"{node} sees {found} of {seen.topic} {_more(seen)}: {_decided(verdict)}"
        needed = f"a filter on {seen.path} in {' and '.join(rules)}"
        return Outcome(seen.line, node, says, failure, rules, needed)


def _first_failure(outcomes: Iterable[Outcome]) -> Outcome:
    """The first that does not hold, else the first."""
    found = list(outcomes)
    return next((each for each in found if not each), found[0])


def _is_one_node(name: str, others: Iterable[str]) -> bool:
    """Whether another node has a name that would be its own if it had a wildcard tail."""
    return any(other != name and names_cover(name, other, wildcard=True) for other in others)


def _keys_of(named: Iterable[SubjectPattern], name: str, subject: Subject) -> list[bytes]:
    """The keys that rules pin for a node or for any, unless the test is about one key."""
    if subject.key != _ANY_KEY:
        return []
    return [who.key for who in named if who.key and (not who.node or covers(who.node, name))]


_ANY_KEY = bytes(32)
_BY_DEFAULT = "no rule matches, so the default decides"
_EFFECTS = {Effect.ALLOW: "may", Effect.DENY: "may not", Effect.PROMPT: "may, if a person says so,"}


def _shown(subject: Subject) -> str:
    name = shown(subject.name)
    return f"{name}, if it is certified with --anonymous," if subject.tail else name


def _clauses(rule: PolicyRule, subject: Subject, right: Right) -> list[Clause]:
    found = (clause.of(subject) for clause in rule.clauses if clause.right is right)
    return [clause for clause in found if clause is not None]


def _decided(verdict: Verdict) -> str:
    names = dict.fromkeys(_named(rule) for rule in verdict.rules)
    return " and ".join(names) or _BY_DEFAULT


def _named(rule: PolicyRule) -> str:
    return f"rule {rule.id}, line {rule.line}"


def _limit(seen: SeenField) -> str:
    return f"no finer than {seen.limit:g}" if isinstance(seen.limit, float) else seen.limit


def _more(seen: SeenField) -> str:
    if isinstance(seen.limit, float):
        return f"finer than {seen.limit:g}"
    words = {EXACT: "otherwise than it is", NOTHING: "at all"}
    return words.get(seen.limit, f"closer than {seen.limit}")

"""Whether the tests of a policy hold: each claim decided as requests are, each field tried. Pure.

A failure names the rule that decided, with its line, and what would be needed.

How precisely a field is seen follows from the operators' algebra, for the whole range of its type and not for
values that were tried. A word of the vocabulary is seen by all fields that tell it
(`grants.vocabulary.assess`); a name that is both, such as `position`, is the word where the type tells it,
and a part of the field `position.x`.
"""

import math
import struct
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from enum import Enum
from itertools import pairwise
from typing import Final, NamedTuple

from ca.names import covers as names_cover
from ca.names import is_alias, pattern_covers, shown
from grants.conditions import compile_condition, reads
from grants.decision import Decision
from grants.errors import FilterRefused, GrantError, MessageRefused, PolicyRefused
from grants.filters.coarsening import read_plan
from grants.filters.hashing import FILTER_KEY_SIZE
from grants.filters.layout import Layout, Primitive, Text
from grants.guard import Guard, needed_keys
from grants.model import TREE_RIGHTS, FilterRule, Restriction, Right, Scalar, format_time
from grants.policy.assertions import (
    EXACT,
    NOTHING,
    CheckedClaim,
    PolicyTest,
    Says,
    SeenField,
    Value,
    below,
    read_back,
    serialize,
)
from grants.policy.decision import Decider, Verdict, is_pattern
from grants.policy.model import Clause, Effect, Policy, PolicyRule, Subject
from grants.policy.names import gives, overlaps, resolve
from grants.policy.rules import is_basics
from grants.policy.source import suggest
from grants.vocabulary.assess import assess, filters_of
from grants.vocabulary.contents import FRAMES, LEVELS, DataWord, Description

Kind = Primitive | Text
LayoutOf = Callable[[str], Layout]
_Parameters = Mapping[str, Scalar]
_FOREVER: Final = 1 << 53
_NOW: Final = 1_000_000
_TOLERANCE: Final = 1e-6
_WORDS: Final = frozenset(word.value for word in DataWord)
_ANY_KEY: Final = bytes(32)
_BY_DEFAULT: Final = "no rule matches, so the default decides"
_EFFECTS: Final = {Effect.ALLOW: "may", Effect.DENY: "may not", Effect.PROMPT: "may, if a person says so,"}
_WHOLE: Final = 1e-9  # how far from a whole number the ratio of two steps may be
_EXACT_UNIT: Final = 1 << 20  # multiples of its inverse, up to 2^32, are exact in 64 bits
_ROOM_FIELDS: Final = ("x", "y")


class Through(Enum):
    NOTHING = "the same whatever is sent"
    STEPS = "one value for each interval of at least a size"
    RANGE = "as it is within a range, which it never leaves"
    TOLD = "another value, that tells which are the same"
    ALL = "as it is"


class Passing(NamedTuple):
    through: Through
    size: float = 0.0
    is_joint: bool = False


def passing(rule: FilterRule, kind: Kind, path: str) -> Passing:
    return _OPERATORS[rule.operator](dict(rule.parameters), kind, path)


def _round(parameters: _Parameters, kind: Kind, _path: str) -> Passing:
    step = float(parameters["step"])
    is_integer = isinstance(kind, Primitive) and len(kind.code) == 1 and kind.code not in "fd"
    return Passing(Through.ALL) if is_integer and step == 1 else Passing(Through.STEPS, step)


def _clamp(parameters: _Parameters, kind: Kind, _path: str) -> Passing:
    low, high = parameters["low"], parameters["high"]
    if isinstance(kind, Primitive) and kind.code in "bBhHiIqQ":
        bits = 8 * kind.size
        least = 0 if kind.code.isupper() else -(1 << bits - 1)
        if (low, high) == (least, least + (1 << bits) - 1):
            return Passing(Through.ALL)
    return Passing(Through.NOTHING if low == high != 0 else Through.RANGE)


def _pixelate(_: _Parameters, _kind: Kind, path: str) -> Passing:
    raise FilterRefused(f"what is seen of {path} depends on other fields of the picture", "ask for its level")


def _rooms(parameters: _Parameters, _kind: Kind, path: str) -> Passing:
    name = path.rpartition(".")[2]
    if name not in _ROOM_FIELDS:
        return Passing(Through.TOLD)  # zero in a room, NaN outside
    plan = read_plan({name: text for name, text in parameters.items() if name != "hysteresis"})
    widths: list[float] = []
    for room in plan:
        # Of a rectangle along the axes its side; of another polygon a line through a corner is as short as
        # one likes.
        upright = all((x0 == x1) != (y0 == y1) for (x0, y0), (x1, y1) in room.edges)
        sides = [corner[_ROOM_FIELDS.index(name)] for corner in room.corners]
        widths.append(max(sides) - min(sides) if upright and len(sides) == 4 else 0.0)
    return Passing(Through.STEPS, min(widths), True)


_Passes = Callable[[_Parameters, Kind, str], Passing]
# A number goes through functions that never decrease, so what lies between two values lies between what
# becomes of them; NaN and infinities pass `round`, and `clamp` makes NaN its lower end. A cell that the
# type's range cuts off, as that of 0 of an unsigned number, counts as a whole one.
_OPERATORS: Final[Mapping[str, _Passes]] = {
    **dict.fromkeys(
        ("clear", "set", "redact", "drop", "zero"), lambda _parameters, _kind, _path: Passing(Through.NOTHING)
    ),
    "round": _round,
    "clamp": _clamp,
    "truncate": lambda parameters, _kind, _path: Passing(
        Through.TOLD if parameters["length"] else Through.NOTHING
    ),
    "hash": lambda _parameters, _kind, _path: Passing(Through.TOLD),
    "pixelate": _pixelate,
    "rooms": _rooms,
    # Which element is which is hidden, but no value.
    "sort": lambda _parameters, _kind, _path: Passing(Through.ALL),
}


def size_of(passed: Iterable[Passing]) -> float:
    """The least size of what stands for one value after all of these, in whichever order; 0: none.

    Applied one after another, steps divide each other's intervals unless each is a whole multiple
    of the one before: then the largest remains, else only the smallest is certain.
    """
    found = (each for each in passed if each.through is Through.STEPS)
    steps = sorted(found, key=lambda each: each.size)
    if not steps:
        return 0.0
    nested = all(_is_multiple(small, large) for small, large in pairwise(steps))
    return max(each.size for each in steps) if nested else min(each.size for each in steps)


def _is_multiple(small: Passing, large: Passing) -> bool:
    if small.size == large.size and not (small.is_joint or large.is_joint):
        return True
    if small.is_joint or large.is_joint or not small.size:
        return False
    ratio = large.size / small.size
    is_exact = all(float(each.size * _EXACT_UNIT).is_integer() for each in (small, large))
    return abs(ratio - round(ratio)) < _WHOLE and (round(ratio) % 2 == 1 or is_exact)


class Visibility:
    """What the receiver of a verdict sees of messages of one layout.

    A leaf is hidden if the ends of its range, both zeros and NaN become the same: that is tried, on the
    filters the publisher would run. One that a condition reads is not hidden, and finer than any step: that
    a message comes tells. But conditions may read `frames`, the leaves that name them: a frame is a
    setting, no value that changes.
    """

    def __init__(self, layout: Layout, verdict: Verdict, frames: Collection[str] = frozenset()) -> None:
        self._frames = frames
        self._layout = layout
        self._leaves = layout.leaves()
        self._conditions = [text for each in verdict.restrictions for text in each.conditions]
        restrictions: tuple[Restriction, ...] = ()
        for each in verdict.restrictions:
            # Without hysteresis, which only makes cells overlap: what was sent before counts for it.
            without = tuple(
                replace(rule, parameters=tuple(x for x in rule.parameters if x[0] != "hysteresis"))
                for rule in each.filters
            )
            if without:
                restrictions += (replace(each, conditions=(), rate=None, slot=None, filters=without),)
        self._rules = [rule for each in restrictions for rule in each.filters]
        decision = Decision(verdict.right, verdict.name, (), _FOREVER, restrictions)
        keys = dict.fromkeys(needed_keys(restrictions), bytes(FILTER_KEY_SIZE))
        self._guard = Guard(layout, decision, keys)

    def is_hidden(self, path: str) -> bool:
        # Whether the leaf at `path` is the same whatever is sent, and whether or not it is.
        return not self._is_read(path) and self._is_constant(path)

    def is_exact(self, path: str) -> bool:
        return all(each.through is Through.ALL for each in self._passing(path))

    def is_no_finer_than(self, path: str, step: float) -> bool:
        # Not NaN and the infinities, which pass `round` and are no interval.
        if self._is_read(path):
            return False
        size = size_of(self._passing(path))
        return self._is_constant(path) or size >= step * (1 - _TOLERANCE)

    def _is_read(self, path: str) -> bool:
        return path not in self._frames and any(reads(text, path) for text in self._conditions)

    def _passing(self, path: str) -> list[Passing]:
        kind = self._leaves[path]
        return [passing(rule, kind, path) for rule in filters_of(self._rules, path)]

    def _is_constant(self, path: str) -> bool:
        passed = self._passing(path)
        if any(each.through is Through.NOTHING for each in passed):
            return True
        kind = self._leaves[path]
        if not any(each.through is Through.RANGE for each in passed) or isinstance(kind, Text):
            return False
        return len({self._seen(path, value) for value in _ends(kind)}) == 1

    def _seen(self, path: str, value: Value) -> str:
        pieces = self._guard.apply(serialize(self._layout, {path: value}), _NOW)
        if pieces is None:
            raise MessageRefused("no message passes")
        return repr(read_back(self._layout, b"".join(pieces))[path])


def _ends(kind: Primitive) -> tuple[Value, ...]:
    if kind.code in "fd":
        return (-math.inf, -0.0, 0.0, math.inf, math.nan)
    bits = 8 * kind.size
    return (-(1 << bits - 1), (1 << bits - 1) - 1) if kind.code.islower() else (0, (1 << bits) - 1)


def seen_too_well(policy: Policy, layout_of: LayoutOf, verdict: Verdict, seen: SeenField) -> str:
    """The first field, or the word, that is seen otherwise than `seen` says; empty if none is."""
    kind = policy.type_of(seen.topic)
    if kind is None:
        hint = f"add it to types: {{{seen.topic}: package/Type}}"
        raise PolicyRefused(f"the message type of {seen.topic} is unknown", hint)
    layout = layout_of(kind)
    description = policy.vocabulary.describe(layout, seen.topic)
    if seen.path in _WORDS and description.tells(DataWord(seen.path)):
        return _word(description, verdict, seen)
    fields = layout.leaves()
    paths = below(fields, seen.path)
    if not paths:
        raise PolicyRefused(f"no field {seen.path!r} in {kind}")
    frames = {each.path for each in description.fields if each.content in FRAMES}
    visible = Visibility(layout, verdict, frames)
    return next((path for path in paths if not _holds(visible, path, fields[path], seen)), "")


def _holds(visible: Visibility, path: str, kind: Primitive | Text, seen: SeenField) -> bool:
    if seen.limit == EXACT:
        return visible.is_exact(path)
    if seen.limit == NOTHING:
        return visible.is_hidden(path)
    if isinstance(seen.limit, str):
        hint = f"write a number (no finer than that), {NOTHING} or {EXACT}"
        raise PolicyRefused(f"not how a field is seen: {seen.limit[:40]!r}", hint)
    if not isinstance(kind, Primitive) or kind.name == "bool":
        raise PolicyRefused(f"{path} is no number", f"write {NOTHING} or {EXACT}")
    return visible.is_no_finer_than(path, seen.limit)


def _word(description: Description, verdict: Verdict, seen: SeenField) -> str:
    word = DataWord(seen.path)
    if isinstance(seen.limit, str) and seen.limit not in LEVELS[word]:
        raise PolicyRefused(f"not a level of {word}: {seen.limit[:40]!r}", suggest(seen.limit, LEVELS[word]))
    if isinstance(seen.limit, float) and word is not DataWord.POSITION:
        raise PolicyRefused(f"{word} has no length", f"write one of {', '.join(LEVELS[word])}")
    found = assess(description, verdict.restrictions, verdict.rate, [word])[word]
    if seen.limit == EXACT:
        return "" if found.level == EXACT and not found.size else word
    if found.is_no_finer_than(seen.limit):
        return ""
    by = f", by {', '.join(found.open)}," if found.open else ""
    return f"{word} ({found.level}{by})".replace(",)", ")")


@dataclass(frozen=True)
class CheckOutcome:
    """Of one claim, or of one field."""

    line: int
    node: str
    says: str  # what was asserted, for people
    failure: str = ""  # why it does not hold; empty: it does
    rules: tuple[str, ...] = ()  # that decided, by id
    needed: str = ""  # what would be needed

    def __bool__(self) -> bool:
        return not self.failure


def check_tests(policy: Policy, layout_of: LayoutOf) -> list[CheckOutcome]:
    """The outcome of every test of `policy`, in the order of the file."""
    checker = _Checker(policy, layout_of)
    return [outcome for each in policy.tests for outcome in checker.outcomes(each)]


def require_tests(policy: Policy, layout_of: LayoutOf) -> None:
    """Return if every test of `policy` holds."""
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

    def outcomes(self, test: PolicyTest) -> Iterator[CheckOutcome]:
        for claim in test.claims:
            checks = self._variants(test) if claim.says is Says.MAY_NOT else [test]
            yield _first_failure(self._claim(each, claim) for each in checks)
        for seen in test.seen:
            first, *others = self._variants(test)
            allowed = (
                each for each in others if self._decider.decide(each.subject, Right.SUBSCRIBE, seen.topic)
            )
            yield _first_failure(self._seen(each, seen) for each in (first, *allowed))

    def _variants(self, test: PolicyTest) -> list[PolicyTest]:
        # The test about all who may be its node: what must not be may be for none of them.
        # The node itself first; then with each key that a rule pins for it or for any node, with a wildcard
        # tail, and of a pattern each node of it that a rule names.
        subject = test.subject
        rules = self._policy.rules
        named = [who for rule in rules for who in (*rule.who, *rule.exceptions)]
        exact = [who.node for who in named if who.node and "*" not in who.node]
        others = {*exact, *(each.subject.name for each in self._policy.tests)}
        found: dict[Subject, None] = {}
        for name in (subject.name, *(x for x in exact if test.pattern and pattern_covers(test.pattern, x))):
            # Unless the test is about one key; and no tail where another node has a name that would be its.
            pinned = [
                who.key for who in named if who.key and (not who.node or pattern_covers(who.node, name))
            ]
            keys = (subject.key, *(pinned if subject.key == _ANY_KEY else ()))
            single = any(other != name and names_cover(name, other, wildcard=True) for other in others)
            tails = (False,) if is_alias(name) or single else (False, True)
            found.update({Subject(name, key, tail): None for key in keys for tail in tails})
        return [replace(test, subject=each) for each in found]

    def _claim(self, test: PolicyTest, claim: CheckedClaim) -> CheckOutcome:
        node, what = _shown(test.subject), f"{claim.right.label} {claim.name}"
        says = f"{claim.says.replace('_', ' ')} {what}"
        verdict = self._decider.decide(test.subject, claim.right, claim.name)
        try:
            failure, needed = self._refuted(test, claim, verdict)
        except (GrantError, ValueError, struct.error, OverflowError) as error:
            # What cannot be evaluated fails, as a field that a type does not have: else a test that tests
            # nothing would pass.
            failure, needed = f"{what} cannot be tried: {error}", "correct the test"
        rules = tuple(dict.fromkeys(rule.id for rule in verdict.rules))
        return CheckOutcome(claim.line, node, says, failure and f"{node} {failure}", rules, needed)

    def _refuted(self, test: PolicyTest, claim: CheckedClaim, verdict: Verdict) -> tuple[str, str]:
        # Why the claim does not hold, and what would be needed; empty if it holds.
        what = f"{claim.right.label} {claim.name}"
        wanted = {Says.MAY: Effect.ALLOW, Says.MAY_NOT: Effect.DENY, Says.ASKS: Effect.PROMPT}
        changes = "; ".join(self._decider.changes(verdict))
        is_whole = is_pattern(verdict.name) or (not verdict and claim.right & TREE_RIGHTS)
        if claim.says is Says.MAY_NOT and is_whole:
            return self._some_allowed(test.subject, claim)
        if claim.says is Says.MAY_NOT and verdict and test.at:
            open_at = [now for now in test.at if not self._closed(verdict, test, now)]
            if not open_at:
                return "", ""
            when = f" at {format_time(open_at[0])}"
            return f"may {what}{when}: {_decided(verdict)}", changes
        if verdict.effect is not wanted[claim.says]:
            return f"{_EFFECTS[verdict.effect]} {what}: {_decided(verdict)}", changes
        for now in test.at if claim.says is Says.MAY else ():
            if closed := self._closed(verdict, test, now):
                needed = "change the condition, or the time of the test"
                return f"may not {what} at {format_time(now)}: not true: {closed}", needed
        return "", ""

    def _some_allowed(self, subject: Subject, claim: CheckedClaim) -> tuple[str, str]:
        # No part of it may be given: who sets /safety/max_speed has set a part of /safety.
        name = resolve(claim.name, subject.name, tail=subject.tail)
        if name is None:
            return "", ""
        rules = self._decider.rules_of(subject)
        denials = (rule for rule in rules if rule.effect is Effect.DENY)
        denied = [each.pattern for rule in denials for each in _clauses(rule, subject, claim.right)]
        for rule in rules:
            if rule.effect is Effect.DENY or (is_basics(rule) and is_pattern(name)):
                continue
            for clause in _clauses(rule, subject, claim.right):
                pair = (clause.pattern, name)
                covered = any(gives(no, claim.right, each) for no in denied for each in pair)
                if overlaps(clause.pattern, claim.right, name) and not covered:
                    failure = f"{_EFFECTS[rule.effect]} {claim.right.label} {clause.pattern}: {rule.cited}"
                    return failure, f"take {clause.pattern} out of {rule.id}, or deny it"
        default = self._policy.defaults.decision
        if default is not Effect.DENY and not any(gives(no, claim.right, name) for no in denied):
            failure = f"{_EFFECTS[default]} {claim.right.label} {name}: {_BY_DEFAULT}"
            return failure, f"a deny rule with {claim.right.label}: [{claim.name}]"
        return "", ""

    def _closed(self, verdict: Verdict, test: PolicyTest, now: int) -> str:
        # The first condition that is not true then; empty if all are.
        for restriction in verdict.restrictions:
            layout, message = None, b""
            if restriction.type is not None:
                layout = self._layout_of(restriction.type)
                unknown = test.message.keys() - layout.leaves().keys()
                if unknown:
                    raise PolicyRefused(f"{restriction.type} has no field {min(unknown)!r}")
                message = serialize(layout, test.message)
            for text in restriction.conditions:
                if compile_condition(layout, text)(message, now) is not True:
                    return text
        return ""

    def _seen(self, test: PolicyTest, seen: SeenField) -> CheckOutcome:
        node = shown(test.subject.name)
        if isinstance(seen.limit, float):
            limit, more = f"no finer than {seen.limit:g}", f"finer than {seen.limit:g}"
        else:
            words = {EXACT: "otherwise than it is", NOTHING: "at all"}
            limit, more = seen.limit, words.get(seen.limit, f"closer than {seen.limit}")
        says = f"sees {seen.path} of {seen.topic}: {limit}"
        verdict = self._decider.decide(test.subject, Right.SUBSCRIBE, seen.topic)
        rules = tuple(dict.fromkeys(rule.id for rule in verdict.rules))
        if not verdict:
            failure = f"{node} may not subscribe {seen.topic}: {_decided(verdict)}"
            needed = f"if it is to see nothing, write {seen.topic}: {NOTHING}"
            return CheckOutcome(seen.line, node, says, failure, rules, needed)
        try:
            found = seen_too_well(self._policy, self._layout_of, verdict, seen)
        except GrantError as error:
            failure = f"{node}: {seen.path} of {seen.topic} cannot be tried: {error}"
            return CheckOutcome(seen.line, node, says, failure, rules, error.hint or "correct the test")
        if not found:
            return CheckOutcome(seen.line, node, says, "", rules)
        failure = f"{node} sees {found} of {seen.topic} {more}: {_decided(verdict)}"
        needed = f"a filter on {seen.path} in {' and '.join(rules)}"
        return CheckOutcome(seen.line, node, says, failure, rules, needed)


def _first_failure(outcomes: Iterable[CheckOutcome]) -> CheckOutcome:
    # The first that does not hold, else the first.
    found = list(outcomes)
    return next((each for each in found if not each), found[0])


def _shown(subject: Subject) -> str:
    name = shown(subject.name)
    return f"{name}, if it is certified with --anonymous," if subject.tail else name


def _clauses(rule: PolicyRule, subject: Subject, right: Right) -> list[Clause]:
    found = (clause.of(subject) for clause in rule.clauses if clause.right is right)
    return [clause for clause in found if clause is not None]


def _decided(verdict: Verdict) -> str:
    names = dict.fromkeys(rule.cited for rule in verdict.rules)
    return " and ".join(names) or _BY_DEFAULT

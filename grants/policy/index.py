"""An index of clauses by name: a tree over segments, so the cost does not grow with the rules.

A lookup follows the segments of the name and the wildcards beside them, nothing else. In a tree
node, clauses for one exact node name are found by that name; the others are compared one by one.
`hits` gives the same result by comparing every clause: the tests compare both, and whole patterns
are only ever looked up with it. Clauses on own names (`{node}/pose`) are found by the node, and
what is found has the pattern that they are for it.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from typing import Final, TypeAlias

from ca.patterns import TAIL
from grants.model import TREE_RIGHTS, Right
from grants.policy.model import Clause, Effect, Policy, PolicyRule, Subject
from grants.policy.own_names import is_own
from grants.policy.patterns import gives, overlaps, segments

Hit: TypeAlias = tuple[PolicyRule, Clause]

_ANY_NODE: Final = ""


@dataclass
class _Branch:
    children: dict[str, "_Branch"] = field(default_factory=dict)
    hits: dict[str, list[Hit]] = field(default_factory=dict)  # by exact node name, or _ANY_NODE


class Index:
    """The clauses of one policy by right and name."""

    def __init__(self, policy: Policy) -> None:
        self._roots: dict[Right, _Branch] = {}
        self._rules: dict[str, dict[int, PolicyRule]] = {}  # by exact node name, or _ANY_NODE
        self._own: dict[tuple[Right, str], list[Hit]] = {}  # likewise
        for at, rule in enumerate(policy.rules):
            for key in _keys(rule):
                self._rules.setdefault(key, {})[at] = rule
            for clause in rule.clauses:
                self._insert(rule, clause)

    def find(self, subject: Subject, right: Right, name: str) -> list[Hit]:
        """Every clause that decides on the exact `name` for `subject`; unordered.

        Args:
            right: exactly one.
            name: an absolute name, or a pattern (then by `hits`).
        """
        if is_pattern(name):
            return list(hits(self.rules_of(subject), subject, right, name))
        return [*self._find_own(subject, right, name), *self._find(subject, right, name)]

    def _find_own(self, subject: Subject, right: Right, name: str) -> Iterator[Hit]:
        for key in (subject.name, _ANY_NODE):
            for rule, clause in self._own.get((right, key), ()):
                found = clause.of(subject) if rule.applies_to(subject) else None
                if found is not None and _decides(rule, found, name):
                    yield rule, found

    def _find(self, subject: Subject, right: Right, name: str) -> list[Hit]:
        root = self._roots.get(right)
        if root is None:
            return []
        branches: dict[int, tuple[_Branch, bool]] = {}
        tree = bool(right & TREE_RIGHTS)
        for branch, whole in _reach(root, name, tree=tree):
            _, before = branches.get(id(branch), (branch, False))
            branches[id(branch)] = (branch, whole or before)  # reached by `**` in several ways
        found: list[Hit] = []
        for branch, whole in branches.values():
            for key in (subject.name, _ANY_NODE):
                for rule, clause in branch.hits.get(key, ()):
                    decides = whole or tree or rule.effect is Effect.DENY
                    if decides and rule.applies_to(subject):
                        found.append((rule, clause))
        return found

    def rules_of(self, subject: Subject) -> list[PolicyRule]:
        """The rules that apply to `subject`, in the order of the policy."""
        named = {**self._rules.get(_ANY_NODE, {}), **self._rules.get(subject.name, {})}
        return [named[at] for at in sorted(named) if named[at].applies_to(subject)]

    def _insert(self, rule: PolicyRule, clause: Clause) -> None:
        if is_own(clause.pattern):
            for key in _keys(rule):
                self._own.setdefault((clause.right, key), []).append((rule, clause))
            return
        branch = self._roots.setdefault(clause.right, _Branch())
        for segment in segments(clause.pattern):
            branch = branch.children.setdefault(segment, _Branch())
        for key in _keys(rule):
            branch.hits.setdefault(key, []).append((rule, clause))


def hits(
    rules: Iterable[PolicyRule], subject: Subject, right: Right, requested: str
) -> Iterator[Hit]:
    """Every clause of `rules` that decides on `requested`, a name or a pattern, for `subject`."""
    return applied((rule for rule in rules if rule.applies_to(subject)), subject, right, requested)


def applied(
    rules: Iterable[PolicyRule], subject: Subject, right: Right, requested: str
) -> Iterator[Hit]:
    """As `hits`, of rules that apply to `subject`.

    Of a pattern, and of a parameter with all below it, every clause counts that overlaps with it: a
    denial denies it, an allowing one adds its restrictions and its validity; whether all of it is
    allowed is checked in `decision`.
    """
    for rule in rules:
        for clause in rule.clauses:
            found = clause.of(subject) if clause.right is right else None
            if found is not None and _decides(rule, found, requested):
                yield rule, found


def is_pattern(requested: str) -> bool:
    """Whether what is requested is more than one name."""
    return "*" in requested or TAIL in requested


def _decides(rule: PolicyRule, clause: Clause, requested: str) -> bool:
    if rule.effect is Effect.DENY or is_pattern(requested) or clause.right & TREE_RIGHTS:
        return overlaps(clause.pattern, clause.right, requested)
    return gives(clause.pattern, clause.right, requested)


def _keys(rule: PolicyRule) -> set[str]:
    """The node names under which the rule is found.

    A denial by pinned key applies to any name.
    """
    nodes = {who.node for who in rule.who}
    by_key = rule.effect is Effect.DENY and any(who.key is not None for who in rule.who)
    if by_key or any(node is None or "*" in node for node in nodes):
        return {_ANY_NODE}
    return {node for node in nodes if node is not None}


def _reach(root: _Branch, name: str, *, tree: bool) -> Iterator[tuple[_Branch, bool]]:
    """Branches whose pattern covers `name` (True), or is below it (False, trees only)."""
    states = {(id(root), False): (root, False)}
    for segment in segments(name):
        following: dict[tuple[int, bool], tuple[_Branch, bool]] = {}
        for branch, repeats_here in states.values():
            if tree and branch is not root:
                yield branch, True  # a right to a parent covers its descendants
            for after, repeats in _follow(branch, segment, repeats_here=repeats_here):
                following[id(after), repeats] = (after, repeats)
        states = following
    for branch in {id(branch): branch for branch, _ in states.values()}.values():
        yield branch, True
        if tree:
            yield from _below(branch)


def _follow(branch: _Branch, segment: str, *, repeats_here: bool) -> Iterator[tuple[_Branch, bool]]:
    if repeats_here:
        yield branch, True
    for key in (segment, "*", "**"):
        child = branch.children.get(key)
        if child is not None:
            yield child, key == "**"


def _below(branch: _Branch) -> Iterator[tuple[_Branch, bool]]:
    for child in branch.children.values():
        yield child, False
        yield from _below(child)

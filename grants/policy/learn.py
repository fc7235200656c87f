"""From observed use to rules: exact names, one rule per node, marked for review.

Two sources. The graph of a running master names publishers, subscribers and providers; callers
and parameters are not part of it. The denial log holds what enforcing nodes and masters would have
denied: one JSON object a line, `{"at": seconds, "node": name, "right": label, "name": name}` and
optionally `"type"`. What a rule already decides is not learned again, in particular no denial; of
names of other masters (`/remote/...`) nothing is learned: no rule of this policy can be about them.
A name below the node's own is learned as `{node}/...`, so it is right for every run of an anonymous
node; what `basics` gives is left to `basics`.
"""

import json
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

from ca.domains.aliases import is_alias
from ca.names import check_name
from grants.basics import is_basic, lasting_name, own_form
from grants.errors import GrantError, PolicyRefused
from grants.model import Right
from grants.policy.decision import Decider
from grants.policy.editing import NewRule, add_rules, free_id
from grants.policy.model import Effect, PolicyRule, Subject, SubjectPattern
from grants.policy.own_names import NODE
from grants.policy.rules import RIGHTS

MAX_LINE: Final = 4096
MAX_OBSERVATIONS: Final = 100_000
_FIELDS: Final = {"at", "node", "right", "name", "type"}
_LEARNED: Final = "learned-"
_MAX_ID: Final = 70  # of 80: a number follows where two names begin alike
_NO_TYPE: Final = ("", "*")


@dataclass(frozen=True, order=True)
class Observation:
    """A node used a right on a name."""

    node: str
    right: Right
    name: str
    type: str = ""


def from_graph(state: object, types: object = ()) -> list[Observation]:
    """The observations in results of `getSystemState` and `getTopicTypes`.

    Raises:
        PolicyRefused: a malformed result.
    """
    rights = (Right.PUBLISH, Right.SUBSCRIBE, Right.PROVIDE)
    try:
        kinds = {str(topic): str(kind) for topic, kind in _list(types)}
        return sorted(
            _observation(node, right, name, kinds.get(str(name), ""))
            for right, entries in zip(rights, _list(state), strict=True)
            for name, nodes in _list(entries)
            for node in _list(nodes)
        )
    except (TypeError, ValueError) as error:
        raise PolicyRefused("not the state of a ROS graph", "is this a master?") from error


def from_log(lines: Iterable[str]) -> list[Observation]:
    """The observations in a denial log.

    Raises:
        PolicyRefused: an invalid line, by its number.
    """
    found: set[Observation] = set()
    for number, line in enumerate(lines, 1):
        if line.strip():
            found.add(_line(number, line))
        if len(found) > MAX_OBSERVATIONS:
            raise PolicyRefused(f"more than {MAX_OBSERVATIONS} different lines", "split the log")
    return sorted(found)


def log_line(at: int, node: str, right: Right, name: str, type_name: str = "") -> str:
    """One line of a denial log, without the newline."""
    row: dict[str, Any] = {"at": at, "node": node, "right": right.label, "name": name}
    return json.dumps({**row, "type": type_name} if type_name else row)


def learn(
    text: str, decider: Decider, observed: Sequence[Observation], day: str
) -> tuple[str, list[NewRule]]:
    """`text`, the policy of `decider`, with rules for what it does not decide yet; and these rules.

    Args:
        day: the date of observation, for the reason.
    """
    lasting = dict.fromkeys(each for item in observed if (each := learnable(item)) is not None)
    new = [item for item in lasting if not _decided(decider, item)]
    by_node: dict[str, list[Observation]] = {}
    for item in new:
        by_node.setdefault(item.node, []).append(item)
    kinds: dict[str, set[str]] = {name: {kind} for name, kind in decider.policy.types.items()}
    for item in lasting:
        kinds.setdefault(item.name, set()).update({item.type} - {*_NO_TYPE})
    taken = {rule.id for rule in decider.policy.rules}
    rules = []
    for node, items in by_node.items():
        name = _id_for(decider.policy.rules, taken, node)
        taken.add(name)
        rules.append(_rule(name, node, items, day, kinds))
    return add_rules(text, rules) if rules else text, rules


def learnable(seen: Observation) -> Observation | None:
    """It as a rule says it: own names as `{node}/...`; None if no rule is to be made of it.

    None of basics, of names of other masters, and of another node's name that will not come again.
    """
    if is_alias(seen.node) or is_alias(seen.name):
        return None
    name = own_form(seen.node, seen.name)
    if is_basic(seen.right, name) or lasting_name(name) != name:
        return None
    return replace(seen, node=lasting_name(seen.node), name=name)


def needs_basics(observed: Iterable[Observation]) -> bool:
    """Whether a node used what only `basics` of a policy is to give."""
    return any(is_basic(item.right, own_form(item.node, item.name)) for item in observed)


def _id_for(rules: Iterable[PolicyRule], taken: Collection[str], node: str) -> str:
    """The rule that was learned for `node` and for nobody else, or a new one's id."""
    for rule in rules:
        if rule.id.startswith(_LEARNED) and _is_learned(rule, node):
            return rule.id
    return free_id(taken, (_LEARNED + node[1:].replace("/", "-"))[:_MAX_ID])


def _is_learned(rule: PolicyRule, node: str) -> bool:
    """Whether it is as `learn` writes it: what is added to it is for `node` alone, as it is."""
    plain = not any(clause.restriction or clause.rate for clause in rule.clauses)
    return (
        rule.effect is Effect.ALLOW
        and rule.who == (SubjectPattern(node, node),)
        and not (rule.exceptions or rule.has_lifetime or rule.keep_when_stale)
        and plain
    )


def _rule(
    name: str,
    node: str,
    observed: Sequence[Observation],
    day: str,
    kinds: Mapping[str, Collection[str]],
) -> NewRule:
    """A rule for `node`. The own topics of nodes that differ in type have types by their names."""
    rights: dict[str, list[str]] = {}
    for item in observed:
        rights.setdefault(item.right.label, []).append(item.name)
    types = {
        item.name if len(kinds[item.name]) == 1 else item.name.replace(NODE, node): item.type
        for item in observed
        if item.type not in _NO_TYPE
    }
    return NewRule(name, f"seen running {day}; review me", node, "allow", rights, types)


def _decided(decider: Decider, observed: Observation) -> bool:
    """Whether a rule decides it; for any key, since observations have none."""
    keys = {who.key for rule in decider.policy.rules for who in rule.who if who.key is not None}
    return any(
        decider.decide(Subject(observed.node, key), observed.right, observed.name).rules
        for key in (bytes(32), *keys)
    )


def _line(number: int, line: str) -> Observation:
    try:
        row = _row(line)
        return _observation(row["node"], RIGHTS[row["right"]], row["name"], row.get("type", ""))
    except (ValueError, TypeError, KeyError, RecursionError, GrantError) as error:
        raise PolicyRefused(
            f"line {number} of the denial log is invalid: {error}",
            '{"at": 0, "node": "/a", "right": "publish", "name": "/b"}',
        ) from error


def _row(line: str) -> dict[str, Any]:
    if len(line) > MAX_LINE:
        raise ValueError(f"more than {MAX_LINE} characters")
    row = json.loads(line)
    if not isinstance(row, dict) or not {"node", "right", "name"} <= row.keys() <= _FIELDS:
        raise ValueError("fields other than at, node, right, name, type")
    return row


def _observation(node: object, right: Right, name: object, kind: object) -> Observation:
    if not (isinstance(node, str) and isinstance(name, str) and isinstance(kind, str)):
        raise TypeError("a name is not text")
    try:
        return Observation(check_name(node), right, check_name(name), kind)
    except Exception as error:
        raise ValueError(str(error)) from error


def _list(value: object) -> Sequence[Any]:
    if not isinstance(value, list | tuple):
        raise TypeError("a list was expected")
    return value

"""A policy file to begin with, rules added to its text, and rules learned from observed use.

Two sources of use: the graph of a running master (publishers, subscribers, providers), and the denial log,
one JSON object a line: `{"at": seconds, "node": name, "right": label, "name": name}` and optionally `"type"`.
What `basics` gives is left to `basics`.
"""

import json
from collections.abc import Collection, Iterable, Mapping, Sequence
from collections.abc import Set as AbstractSet
from dataclasses import dataclass, field, replace
from io import StringIO
from itertools import count
from typing import Any, Final

from ruamel.yaml import YAML
from ruamel.yaml.comments import CommentedMap, CommentedSeq
from ruamel.yaml.resolver import VersionedResolver

from ca.names import check_name, is_alias
from grants.errors import GrantError, PolicyRefused
from grants.model import Right
from grants.policy.decision import Decider
from grants.policy.model import Effect, PolicyRule, Subject, SubjectPattern
from grants.policy.names import NODE
from grants.policy.rules import RIGHTS
from grants.policy.source import Mistakes, Part, YamlMapping, YamlScalar, YamlSequence, read_source
from grants.request import is_basic, lasting_name, own_form

_TEXT: Final = """\
# Who may do what, how precisely, and how long: docs/spec/policy.md.
#   rossec policy check    every mistake in this file; also runs the tests below
#   rossec policy lint     what it allows unwisely
#   rossec policy apply    shows the difference to what is granted, asks, and puts it in force
rossec: 1
robot: {robot}
basics: true  # what every ROS program needs: its log, its loggers, the clock; [tf]: transforms too
defaults: {{lifetime: 7d}}

# The message type of each topic that a filter or a condition of a rule looks into, as in
#   types: {{/robot/pose: geometry_msgs/PoseStamped}}
types: {{}}

# What no rule allows is denied, and one denial overrides all that allows. Names below the asking
# node's own are ~/pose or "{{node}}/pose"; * is one segment of a name, ** one or more. As in
#   rules:
#     - {{id: pose, who: /robot, allow: {{publish: [~/pose]}}, why: it says where it is}}
#     - id: heating
#       why: lowers empty rooms
#       who: /heating
#       allow: {{subscribe: [/robot/pose]}}
#       see: {{position: room}}
rules: []

# What must stay true whatever is changed above; apply refuses a policy of which one fails. As in
#   tests:
#     - {{who: /heating, may_not: {{publish: /**}}, sees: {{/robot/pose: {{position: room}}}}}}
tests: []
"""


_EMPTY: Final = """# A policy of rossec; see docs/spec/policy.md.
rossec: 1
robot: {robot}
defaults: {{decision: deny, lifetime: 7d}}
types: {{}}
rules: []
"""
_NO_FOLDING: Final = 1 << 30  # columns: a folded text loses its spaces at the end of a line
MAX_LINE: Final = 4096
MAX_OBSERVATIONS: Final = 100_000
_FIELDS: Final = {"at", "node", "right", "name", "type"}
_LEARNED: Final = "learned-"
_MAX_ID: Final = 70  # of 80: a number follows where two names begin alike
_NO_TYPE: Final = ("", "*")


def beginning(robot: str) -> str:
    """The commented text that `rossec policy init` writes: every node gets what every ROS program needs."""
    return _TEXT.format(robot=json.dumps(robot))


@dataclass(frozen=True)
class NewRule:
    """A rule to add. `rights` are name patterns by right label."""

    id: str
    why: str
    who: str
    effect: str
    rights: Mapping[str, Iterable[str]]
    types: Mapping[str, str] = field(default_factory=dict)
    filter: str | None = None


def empty(robot: str = "robot") -> str:
    """A policy that denies everything."""
    return _EMPTY.format(robot=robot)


def add_rules(text: str, rules: Iterable[NewRule]) -> str:
    """`text` with `rules` added; an existing rule with the same id is extended."""
    rules = list(rules)
    yaml = YAML(typ="rt", pure=True)
    yaml.preserve_quotes = True
    yaml.width = _NO_FOLDING
    yaml.Resolver = _TextResolver
    yaml.indent(mapping=2, sequence=4, offset=2)
    data = yaml.load(text)
    known = _rules(data)
    for rule in rules:
        if rule.types and not data.get("types"):
            data["types"] = CommentedMap()
        for topic, kind in rule.types.items():
            if topic not in data["types"]:  # before the others: comments belong to the last
                data["types"].insert(0, topic, kind)
        if rule.id not in known:
            entry = known[rule.id] = CommentedMap(id=rule.id, why=rule.why, who=rule.who)
            entry[rule.effect] = CommentedMap()
            if rule.filter is not None:
                entry["filter"] = CommentedMap(use=rule.filter)
            data["rules"].append(entry)
        rights = known[rule.id][rule.effect]
        for label, patterns in rule.rights.items():
            present = rights.get(label, [])
            present = present if isinstance(present, list) else [present]
            row = CommentedSeq([*present, *(name for name in patterns if name not in present)])
            row.fa.set_flow_style()
            rights[label] = row
    out = StringIO()
    yaml.dump(data, out)
    _check(text, out.getvalue(), rules)
    return out.getvalue()


def free_id(taken: Iterable[str], preferred: str) -> str:
    """`preferred`, or `preferred-2` and so on."""
    used = taken if isinstance(taken, AbstractSet) else set(taken)
    names = (preferred if number == 1 else f"{preferred}-{number}" for number in count(1))
    return next(name for name in names if name not in used)


class _TextResolver(VersionedResolver):
    @property
    def versioned_resolver(self) -> dict[str, Any]:  # every plain scalar is a text
        return {}


def _check(before: str, after: str, rules: Iterable[NewRule]) -> None:
    # What writes is another parser than what reads, so both texts are read by the one of policies: the
    # result is the old policy and the new rules, value by value, or it is refused.
    expected, found = _values(before), _values(after)
    assert isinstance(expected, dict)  # noqa: S101 - it was loaded as a policy
    for rule in rules:
        _add_values(expected, rule)
    if found != expected:
        listed = ", ".join(f"{rule.effect} for {rule.who} ({rule.id})" for rule in rules)
        raise PolicyRefused(
            "this policy cannot be rewritten without changing what it says, nothing was written",
            f"add the rules by hand: {listed}",
        )


def _values(text: str) -> object:
    mistakes = Mistakes("the policy")
    source = read_source(text, mistakes)
    mistakes.raise_if_any()
    return _value(source)


def _value(part: Part | None) -> object:
    if isinstance(part, YamlMapping):
        return {key: _value(value) for key, (_, value) in part.entries.items()}
    if isinstance(part, YamlSequence):
        return [_value(item) for item in part.items]
    return (type(part.value).__name__, repr(part.value)) if isinstance(part, YamlScalar) else None


def _text(value: str) -> object:
    return "str", repr(value)


def _add_values(policy: dict[str, Any], rule: NewRule) -> None:
    if rule.types:
        types = policy["types"] if isinstance(policy.get("types"), dict) else {}
        policy["types"] = {**{name: _text(kind) for name, kind in rule.types.items()}, **types}
    known = policy["rules"]
    policy["rules"] = known = known if isinstance(known, list) else [known]
    if known == [_text("")]:
        known.clear()
    entry = next((item for item in known if item["id"] == _text(rule.id)), None)
    if entry is None:
        entry = {"id": _text(rule.id), "why": _text(rule.why), "who": _text(rule.who)}
        entry[rule.effect] = {}
        if rule.filter is not None:
            entry["filter"] = {"use": _text(rule.filter)}
        known.append(entry)
    rights = entry[rule.effect]
    for label, patterns in rule.rights.items():
        present = rights.get(label, [])
        present = present if isinstance(present, list) else [present]
        rights[label] = [*present, *(x for x in map(_text, patterns) if x not in present)]


def _rules(data: Any) -> dict[str, Any]:
    if not data["rules"]:
        data["rules"] = CommentedSeq()
    if isinstance(data["rules"], CommentedMap):  # a single rule may be written without a dash
        data["rules"] = CommentedSeq([data["rules"]])
    return {item["id"]: item for item in data["rules"]}


@dataclass(frozen=True, order=True)
class Observation:
    """A node used a right on a name."""

    node: str
    right: Right
    name: str
    type: str = ""


def from_graph(state: object, types: object = ()) -> list[Observation]:
    """The observations in results of `getSystemState` and `getTopicTypes`."""
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
    """The observations in a denial log."""
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
    """`text`, the policy of `decider`, with rules for what it does not decide yet; and these rules."""
    lasting = dict.fromkeys(each for item in observed if (each := learnable(item)) is not None)
    # What a rule already decides is not learned again, in particular no denial.
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
        own = (SubjectPattern(node, node),)
        same = (each.id for each in decider.policy.rules if each.who == own and _is_plain(each))
        name = next(same, "") or free_id(taken, (_LEARNED + node[1:].replace("/", "-"))[:_MAX_ID])
        taken.add(name)
        rules.append(_rule(name, node, items, day, kinds))
    return add_rules(text, rules) if rules else text, rules


def learnable(seen: Observation) -> Observation | None:
    """It as a rule says it: own names as `{node}/...`; None if no rule is to be made of it.

    None of basics, of names of other masters, and of another node's name that will not come again.
    """
    if is_alias(seen.node) or is_alias(seen.name):
        return None
    name = own_form(seen.node, seen.name)  # right for every run of an anonymous node
    if is_basic(seen.right, name) or lasting_name(name) != name:
        return None
    return replace(seen, node=lasting_name(seen.node), name=name)


def needs_basics(observed: Iterable[Observation]) -> bool:
    """Whether a node used what only `basics` of a policy is to give."""
    return any(is_basic(item.right, own_form(item.node, item.name)) for item in observed)


def _is_plain(rule: PolicyRule) -> bool:
    # Learned before, and nobody has restricted it since: so it may be extended.
    restricted = any(clause.restriction or clause.rate for clause in rule.clauses)
    further = restricted or rule.exceptions or rule.has_lifetime or rule.keep_when_stale
    return rule.id.startswith(_LEARNED) and rule.effect is Effect.ALLOW and not further


def _rule(
    name: str, node: str, observed: Sequence[Observation], day: str, kinds: Mapping[str, Collection[str]]
) -> NewRule:
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
    # Whether a rule decides it; for any key, since observations have none.
    keys = {who.key for rule in decider.policy.rules for who in rule.who if who.key is not None}
    return any(
        decider.decide(Subject(observed.node, key), observed.right, observed.name).rules
        for key in (bytes(32), *keys)
    )


def _line(number: int, line: str) -> Observation:
    try:
        if len(line) > MAX_LINE:
            raise ValueError(f"more than {MAX_LINE} characters")
        row = json.loads(line)
        if not isinstance(row, dict) or not {"node", "right", "name"} <= row.keys() <= _FIELDS:
            raise ValueError("fields other than at, node, right, name, type")
        return _observation(row["node"], RIGHTS[row["right"]], row["name"], row.get("type", ""))
    except (ValueError, TypeError, KeyError, RecursionError, GrantError) as error:
        raise PolicyRefused(
            f"line {number} of the denial log is invalid: {error}",
            '{"at": 0, "node": "/a", "right": "publish", "name": "/b"}',
        ) from error


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

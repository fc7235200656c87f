"""Adding rules to a policy file without changing the rest: comments, order and quotes stay.

Text in, text out; `load` must have accepted the text (it bounds the cost of its YAML). What writes
is another parser than what reads, so both texts are read by the one of policies: the result is the
old policy and the new rules, value by value, or it is refused.
"""

from collections.abc import Iterable, Mapping
from collections.abc import Set as AbstractSet
from dataclasses import dataclass, field
from io import StringIO
from typing import Any, Final

from ruamel.yaml import YAML
from ruamel.yaml.comments import CommentedMap, CommentedSeq
from ruamel.yaml.resolver import VersionedResolver

from grants.errors import PolicyRefused
from grants.policy.mistakes import Mistakes
from grants.policy.source import Part, YamlMapping, YamlScalar, YamlSequence, read_source

EMPTY: Final = """# A policy of rossec; see docs/spec/policy.md.
rossec: 1
robot: {robot}
defaults: {{decision: deny, lifetime: 7d}}
types: {{}}
rules: []
"""


_NO_FOLDING: Final = 1 << 30  # columns: a folded text loses its spaces at the end of a line


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
    return EMPTY.format(robot=robot)


def add_rules(text: str, rules: Iterable[NewRule]) -> str:
    """`text` with `rules` added; an existing rule with the same id is extended.

    Raises:
        PolicyRefused: the text cannot be rewritten so that nothing else in it changes.
    """
    rules = list(rules)
    yaml = _yaml()
    data = yaml.load(text)
    known = _rules(data)
    for rule in rules:
        _add_types(data, rule.types)
        _add_rule(data, known, rule)
    out = StringIO()
    yaml.dump(data, out)
    _check(text, out.getvalue(), rules)
    return out.getvalue()


def free_id(taken: Iterable[str], preferred: str) -> str:
    """`preferred`, or `preferred-2` and so on."""
    used = taken if isinstance(taken, AbstractSet) else set(taken)
    number = 1
    name = preferred
    while name in used:
        number += 1
        name = f"{preferred}-{number}"
    return name


class _TextResolver(VersionedResolver):
    """Each plain scalar is its text: written as it was read, whatever it may stand for."""

    @property
    def versioned_resolver(self) -> dict[str, Any]:
        """No kinds of scalars."""
        return {}


def _check(before: str, after: str, rules: Iterable[NewRule]) -> None:
    """Return if `after` says what `before` does, and `rules`, and nothing else.

    Raises:
        PolicyRefused: it does not.
    """
    expected, found = _values(before), _values(after)
    assert isinstance(expected, dict)  # noqa: S101 - it was loaded as a policy
    for rule in rules:
        _add_values(expected, rule)
    if found != expected:
        raise PolicyRefused(
            "this policy cannot be rewritten without changing what it says, nothing was written",
            "add the rules by hand: "
            + ", ".join(f"{rule.effect} for {rule.who} ({rule.id})" for rule in rules),
        )


def _values(text: str) -> object:
    """What a text says, each scalar with its kind; keys in any order, as in a policy."""
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
    return _value(YamlScalar(value, 0, 0))


def _add_values(policy: dict[str, Any], rule: NewRule) -> None:
    """`rule` as `add_rules` adds it, in the values of a policy."""
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


def _yaml() -> YAML:
    yaml = YAML(typ="rt", pure=True)
    yaml.preserve_quotes = True
    yaml.width = _NO_FOLDING
    yaml.Resolver = _TextResolver
    yaml.indent(mapping=2, sequence=4, offset=2)
    return yaml


def _add_types(data: Any, types: Mapping[str, str]) -> None:
    if types and not data.get("types"):
        data["types"] = CommentedMap()
    for topic, kind in types.items():
        if topic not in data["types"]:  # before the others: comments belong to the last
            data["types"].insert(0, topic, kind)


def _rules(data: Any) -> dict[str, Any]:
    """The existing rules by id; afterwards `data` has a list of rules."""
    if not data["rules"]:
        data["rules"] = CommentedSeq()
    if isinstance(data["rules"], CommentedMap):  # a single rule may be written without a dash
        data["rules"] = CommentedSeq([data["rules"]])
    return {item["id"]: item for item in data["rules"]}


def _add_rule(data: Any, known: dict[str, Any], rule: NewRule) -> None:
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
        new = [name for name in patterns if name not in present]
        rights[label] = _flow([*present, *new])


def _flow(items: Iterable[str]) -> CommentedSeq:
    row = CommentedSeq(items)
    row.fa.set_flow_style()
    return row

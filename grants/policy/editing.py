"""Adding rules to a policy file without changing the rest: comments, order and quotes stay.

Text in, text out; `load` must have accepted the text (it bounds the cost of its YAML). The caller
should load the result again.
"""

from collections.abc import Iterable, Mapping
from collections.abc import Set as AbstractSet
from dataclasses import dataclass, field
from io import StringIO
from typing import Any, Final

from ruamel.yaml import YAML
from ruamel.yaml.comments import CommentedMap, CommentedSeq

EMPTY: Final = """# A policy of rossec; see docs/spec/policy.md.
rossec: 1
robot: {robot}
defaults: {{decision: deny, lifetime: 7d}}
types: {{}}
rules: []
"""


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
    """`text` with `rules` added; an existing rule with the same id is extended."""
    yaml = _yaml()
    data = yaml.load(text)
    known = _rules(data)
    for rule in rules:
        _add_types(data, rule.types)
        _add_rule(data, known, rule)
    out = StringIO()
    yaml.dump(data, out)
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


def _yaml() -> YAML:
    yaml = YAML(typ="rt", pure=True)
    yaml.preserve_quotes = True
    yaml.width = 100
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

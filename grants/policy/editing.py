"""Adding to a policy file without touching the rest: comments, order and quotes stay.

Text in, text out; the text must be one `load` has accepted (it bounds what YAML can do to us).
Whoever writes the result should load it once more.
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
    """`text` with `rules` added; one whose id is there gains what it lacks."""
    yaml = _yaml()
    data = yaml.load(text)
    known = _rules(data)
    for rule in rules:
        _add_types(data, rule.types)
        _add_rule(data, known, rule)
    out = StringIO()
    yaml.dump(data, out)
    return out.getvalue()


def free_id(taken: Iterable[str], wish: str) -> str:
    """`wish`, or `wish-2` and so on."""
    used = taken if isinstance(taken, AbstractSet) else set(taken)
    number = 1
    name = wish
    while name in used:
        number += 1
        name = f"{wish}-{number}"
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
        if topic not in data["types"]:  # before the rest: comments hang on the last
            data["types"].insert(0, topic, kind)


def _rules(data: Any) -> dict[str, Any]:
    """The rules that are there, by their ids; the list is made fit to be added to."""
    if not data["rules"]:
        data["rules"] = CommentedSeq()
    if isinstance(data["rules"], CommentedMap):  # a single rule may stand without a dash
        data["rules"] = CommentedSeq([data["rules"]])
    return {item["id"]: item for item in data["rules"]}


def _add_rule(data: Any, known: dict[str, Any], rule: NewRule) -> None:
    if rule.id not in known:
        made = known[rule.id] = CommentedMap(id=rule.id, why=rule.why, who=rule.who)
        made[rule.effect] = CommentedMap()
        if rule.filter is not None:
            made["filter"] = CommentedMap(use=rule.filter)
        data["rules"].append(made)
    rights = known[rule.id][rule.effect]
    for label, patterns in rule.rights.items():
        there = rights.get(label, [])
        there = there if isinstance(there, list) else [there]
        new = [name for name in patterns if name not in there]
        rights[label] = _flow([*there, *new])


def _flow(items: Iterable[str]) -> CommentedSeq:
    row = CommentedSeq(items)
    row.fa.set_flow_style()
    return row

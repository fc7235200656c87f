"""Which data is collected, who has access and why: every field, every receiver, until when.

The effect of a right field by field, for a record of processing (GDPR article 30) as much as for
users at home. Built from what the policy allows or from live grants: both are `ReceiverAccess`.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, dataclass
from typing import Final

from grants.filters.layout import Array, Layout, Struct, Type
from grants.limits import rate_text
from grants.model import FilterRule, Restriction, Right
from grants.policy.decision import Decider, span
from grants.policy.model import Effect, Subject, SubjectPattern
from grants.policy.vocabulary import Vocabulary
from grants.vocabulary.assess import assess
from grants.vocabulary.sentences import sentence

AS_IT_IS: Final = "as it is"
WHOLE: Final = "(everything)"
_MAX_LEAVES: Final = 512


@dataclass(frozen=True)
class ReceiverAccess:
    """Access of one receiver to one topic (or all topics of a pattern)."""

    topic: str
    type: str | None
    receiver: str
    why: str
    until: str
    by: str = ""
    restrictions: tuple[Restriction, ...] = ()
    rate: float | None = None


@dataclass(frozen=True, order=True)
class PrivacyRow:
    """One field, one receiver; `tells` is the field's word, `sees` what is seen of the topic."""

    topic: str
    type: str
    receiver: str
    field: str
    treatment: str
    when: str
    why: str
    until: str
    by: str
    tells: str = ""
    sees: str = ""


def from_policy(decider: Decider) -> list[ReceiverAccess]:
    """The access that the policy allows: every subscription that no denial overrides."""
    found: dict[tuple[str, str], ReceiverAccess] = {}
    for rule in decider.policy.rules:
        if rule.effect is not Effect.ALLOW:
            continue
        for clause in rule.clauses:
            for who in rule.who if clause.right is Right.SUBSCRIBE else ():
                access = _access(decider, who, clause.pattern)
                if access is not None:
                    found.setdefault((access.topic, access.receiver), access)
    return list(found.values())


def _access(decider: Decider, who: SubjectPattern, pattern: str) -> ReceiverAccess | None:
    node = (who.node or "/x").replace("**", "x").replace("*", "x")
    verdict = decider.decide(Subject(node, who.key or bytes(32)), Right.SUBSCRIBE, pattern)
    if not verdict:
        return None
    topic = pattern if "*" in (who.node or "*") else verdict.name
    renewed = f", renewed for {span(verdict.renew_until)}" if verdict.renew_until else ""
    return ReceiverAccess(
        topic,
        decider.policy.type_of(pattern),
        who.node or who.label,
        "; ".join(dict.fromkeys(item.why for item in verdict.rules if item.why)),
        f"{span(verdict.lifetime)} at a time{renewed}",
        "rule " + ", ".join(dict.fromkeys(item.id for item in verdict.rules)),
        verdict.restrictions,
        verdict.rate,
    )


def rows(
    accesses: Iterable[ReceiverAccess],
    layout_of: Callable[[str], Layout],
    vocabulary: Vocabulary | None = None,
) -> list[PrivacyRow]:
    """Field by field; a topic of unknown type is one row. `vocabulary` is that of the policy."""
    found: list[PrivacyRow] = []
    for access in accesses:
        filters = [rule for item in access.restrictions for rule in item.filters]
        kind = access.type
        layout = None if kind is None else layout_of(kind)
        fields = [WHOLE] if layout is None else leaf_paths(layout)
        tells, sees = _in_words(access, layout, vocabulary or Vocabulary())
        found += [
            PrivacyRow(access.topic, kind or "type not known", access.receiver, path,
                ", then ".join(map(_text, filters_of(filters, path))) or AS_IT_IS, _when(access),
                access.why, access.until, access.by, tells.get(path, ""), sees)
            for path in fields
        ]  # fmt: skip
    return sorted(found)


def _in_words(
    access: ReceiverAccess, layout: Layout | None, vocabulary: Vocabulary
) -> tuple[dict[str, str], str]:
    """The word that each field tells, by path, and what is seen in all, as a sentence."""
    if layout is None:
        return {}, ""
    described = vocabulary.describe(layout, access.topic)
    tells = {each.path: str(each.meaning.own or each.content) for each in described.fields}
    return tells, sees(access, layout, vocabulary)


def sees(access: ReceiverAccess, layout: Layout, vocabulary: Vocabulary | None = None) -> str:
    """What the receiver sees: `where it is: the room; not how it moves`."""
    described = (vocabulary or Vocabulary()).describe(layout, access.topic)
    return sentence(assess(described, access.restrictions, access.rate).values())


def _when(access: ReceiverAccess) -> str:
    parts = [text for item in access.restrictions for text in item.conditions]
    if access.rate is not None:
        parts.append(rate_text(access.rate))
    slots = (item.slot for item in access.restrictions if item.slot is not None)
    parts += [f"one at the start of each {slot} s" for slot in slots]
    return " and ".join(dict.fromkeys(parts)) or "always"


def _text(rule: FilterRule) -> str:
    return " ".join([rule.operator, *(f"{name} {value}" for name, value in rule.parameters)])


def filters_of(filters: Iterable[FilterRule], path: str) -> list[FilterRule]:
    """The rules that apply to the field at `path`: its own, and those of its parents.

    `sort` of an array hides which element is which, but nothing of its fields.
    """
    steps = path.replace("[*]", "").split(".")
    found = []
    for rule in filters:
        parent = rule.path.replace("[*]", "").split(".")
        if steps[: len(parent)] == parent and rule.operator != "sort":
            found.append(rule)
    return found


def leaf_paths(layout: Layout) -> list[str]:
    """The paths of all leaf fields, in the notation of filters."""
    found: list[str] = []
    _walk(layout.root, "", found)
    return found[:_MAX_LEAVES]


def _walk(kind: Type, path: str, found: list[str]) -> None:
    inner = kind.element if isinstance(kind, Array) else kind
    if not isinstance(inner, Struct):
        found.append(path)
        return
    here = f"{path}[*]." if isinstance(kind, Array) else f"{path}." if path else ""
    for name, member in inner.fields:
        if len(found) < _MAX_LEAVES:
            _walk(member, here + name, found)


def lines(found: Sequence[PrivacyRow]) -> list[str]:
    """The report for a terminal: fields with the same treatment together."""
    report: list[str] = []
    groups: dict[tuple[str, ...], dict[str, list[str]]] = {}
    for row in found:
        key = (row.topic, row.type, row.receiver, row.when, row.why, row.until, row.by, row.sees)
        groups.setdefault(key, {}).setdefault(row.treatment, []).append(row.field)
    for (topic, kind, receiver, when, why, until, by, seen), treatments in groups.items():
        report.append(f"{topic} ({kind}) -> {receiver}")
        report += [f"  sees {seen}"] if seen else []
        report.append(f"  why: {why or 'no reason given'} ({by})")
        report += [f"  when: {when}", f"  until: {until}"]
        report += [f"  {name}: {', '.join(fields)}" for name, fields in treatments.items()]
    return report or ["no receiver has access"]


def as_json(found: Sequence[PrivacyRow]) -> list[dict[str, str]]:
    """The rows for programs."""
    return [asdict(row) for row in found]

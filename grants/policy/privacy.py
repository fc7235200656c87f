"""Which data is collected, who has access and why: every field, every receiver, until when. Pure.

The effect of a right field by field, for a record of processing (GDPR article 30) as much as for users at
home. Built from what the policy allows or from live grants: both are `ReceiverAccess`.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, dataclass
from typing import Final

from grants.conditions import compile_condition
from grants.decision import Decision
from grants.errors import GrantError
from grants.filters.hashing import FILTER_KEY_SIZE
from grants.filters.layout import Buffer, Layout
from grants.guard import Guard, needed_keys
from grants.limits import rate_text
from grants.model import Restriction, Right
from grants.policy.decision import Decider, Verdict, span
from grants.policy.model import Effect, Policy, SubjectPattern, Vocabulary
from grants.policy.wanted import permissions
from grants.vocabulary.assess import Seen, assess, details, filters_of, seen, sentence
from grants.vocabulary.contents import DataWord

AS_IT_IS: Final = "as it is"
WHOLE: Final = "(everything)"
_MAX_LEAVES: Final = 512
_FOREVER: Final = 1 << 53
LayoutOf = Callable[[str], Layout]


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
    found: dict[tuple[str, str], ReceiverAccess] = {}
    for rule in decider.policy.rules:
        if rule.effect is not Effect.ALLOW:
            continue
        for clause in rule.clauses:
            for who in rule.who if clause.right is Right.SUBSCRIBE else ():
                if (access := _access(decider, who, clause.pattern)) is not None:
                    found.setdefault((access.topic, access.receiver), access)
    return list(found.values())


def _access(decider: Decider, who: SubjectPattern, pattern: str) -> ReceiverAccess | None:
    verdict = decider.decide(who.sample, Right.SUBSCRIBE, pattern)
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
    accesses: Iterable[ReceiverAccess], layout_of: LayoutOf, vocabulary: Vocabulary | None = None
) -> list[PrivacyRow]:
    found: list[PrivacyRow] = []
    for access in accesses:
        filters = [rule for item in access.restrictions for rule in item.filters]
        kind = access.type
        layout = None if kind is None else layout_of(kind)
        fields = [WHOLE] if layout is None else leaf_paths(layout)
        treated = {path: filters_of(filters, path) for path in fields}
        tells: dict[str, str] = {}
        in_words = ""
        if layout is not None:
            described = (vocabulary or Vocabulary()).describe(layout, access.topic)
            tells = {each.path: str(each.meaning.own or each.content) for each in described.fields}
            in_words = sees(access, layout, vocabulary)
        found += [
            PrivacyRow(
                access.topic,
                kind or "type not known",
                access.receiver,
                path,
                ", then ".join(str(rule).partition(": ")[2] for rule in rules) or AS_IT_IS,
                _when(access),
                access.why,
                access.until,
                access.by,
                tells.get(path, ""),
                in_words,
            )
            for path, rules in treated.items()
        ]
    return sorted(found)


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


def leaf_paths(layout: Layout) -> list[str]:
    """The paths of the leaf fields, in the notation of filters; of so many at most."""
    return list(layout.leaves(_MAX_LEAVES))


def lines(found: Sequence[PrivacyRow]) -> list[str]:
    report: list[str] = []
    groups: dict[tuple[str, ...], dict[str, list[str]]] = {}
    for row in found:
        key = (row.topic, row.type, row.receiver, row.when, row.why, row.until, row.by, row.sees)
        groups.setdefault(key, {}).setdefault(row.treatment, []).append(row.field)
    for (topic, kind, receiver, when, why, until, by, sees), treatments in groups.items():
        report.append(f"{topic} ({kind}) -> {receiver}")
        report += [f"  sees {sees}"] if sees else []
        report.append(f"  why: {why or 'no reason given'} ({by})")
        report += [f"  when: {when}", f"  until: {until}"]
        report += [f"  {name}: {', '.join(fields)}" for name, fields in treatments.items()]
    return report or ["no receiver has access"]


def as_json(found: Sequence[PrivacyRow]) -> list[dict[str, str]]:
    return [asdict(row) for row in found]


def shown(
    policy: Policy, verdict: Verdict, layout_of: LayoutOf, words: Sequence[DataWord] | None = None
) -> dict[DataWord, Seen]:
    """At which level each word of the topic is seen; empty for what is not allowed or not known.

    `words` are those asked for; without them those the type carries.
    """
    kind = next((item.type for item in verdict.restrictions if item.type), None)
    kind = kind or policy.type_of(verdict.name)
    if not verdict or kind is None:
        return {}
    described = policy.vocabulary.describe(layout_of(kind), verdict.name)
    return assess(described, verdict.restrictions, verdict.rate, words)


def level_lines(found: dict[DataWord, Seen]) -> list[str]:
    """One line for each word: `sees where it is: the room (no finer than 4 m, ...)`."""
    return [
        f"sees {seen(one)}" + (f" ({numbers})" if (numbers := details(one)) else "") for one in found.values()
    ]


def levels_json(found: dict[DataWord, Seen]) -> dict[str, str]:
    """The level by word; a position between two levels is `2 m`."""
    return {word.value: one.size_text or one.level for word, one in found.items()}


@dataclass(frozen=True)
class TrialOutcome:
    """`message` is what the receiver gets, or None; then `reason` is set."""

    message: bytes | None
    reason: str = ""


# The effect on one message before anything is granted, by the guard that a publisher would have: not a
# description of it.
class Trial:
    """One verdict, tried on messages of one layout."""

    def __init__(self, layout: Layout, verdict: Verdict) -> None:
        self._layout = layout
        self._verdict = verdict
        self._guard: Guard | None = None
        if not verdict:
            why = verdict.rules[0].reason if verdict.rules else "no rule matches"
            self._reason = f"{verdict.effect}: {why}"
            return
        given = tuple(item.restriction for item in permissions(verdict) if item.restriction is not None)
        decision = Decision(verdict.right, verdict.name, (), _FOREVER, given)
        try:
            keys = dict.fromkeys(needed_keys(given), bytes(FILTER_KEY_SIZE))  # placeholders
            self._guard = Guard(layout, decision, keys)
        except GrantError as error:
            self._reason = str(error)

    def __call__(self, message: Buffer, now: int) -> TrialOutcome:
        """Try `message` (serialized) at `now`, seconds since the epoch."""
        if self._guard is None:
            return TrialOutcome(None, self._reason)
        try:
            pieces = self._guard(message, now)
        except GrantError as error:
            return TrialOutcome(None, str(error))
        if pieces is None:
            return TrialOutcome(None, self._failed_condition(message, now))
        return TrialOutcome(b"".join(pieces))

    def _failed_condition(self, message: Buffer, now: int) -> str:
        # As the guard asks: the first condition that is not true, else the slot, else the rate.
        for restriction in self._verdict.restrictions:
            layout = self._layout if restriction.type is not None else None
            for text in restriction.conditions:
                if not compile_condition(layout, text)(message, now):
                    return f"the condition is not true: {text}"
        slots = [item.slot for item in self._verdict.restrictions if item.slot is not None]
        if slots:
            return f"not the one message at the start of each {max(slots)} s"
        rate = self._verdict.rate
        return "not admitted" if rate is None else f"more than {rate:g} messages a second"

"""The report: every field of every topic, who receives it, how, why and until when. Pure.

The same accesses as `rossec privacy` prints (`grants.policy.privacy`), in words, with receivers
that are treated alike together. The page of the console and the file of the command line are made
of it.
"""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from typing import Final, NamedTuple

from grants.errors import GrantError
from grants.filters.layout import Layout
from grants.model import FilterRule, Right
from grants.policy.privacy import WHOLE, ReceiverAccess, filters_of, leaf_paths, sees
from grants.policy.vocabulary import Vocabulary
from rossec.console import words
from rossec.console.matrix import HeldGrant
from rossec.errors import MessageError

AS_IT_IS: Final = "as it is"
REMOVED: Final = "removed"

Wanted = Callable[[str, str], bool]
"""Whether a receiver's field is in the report."""


class ReportReceiver(NamedTuple):
    """Who receives it: why, until when, and by what (a rule, a grant)."""

    name: str
    why: str
    until: str
    by: str


class ReportFields(NamedTuple):
    """Fields that are treated alike."""

    treatment: str
    is_open: bool
    fields: tuple[str, ...]


class ReportGroup(NamedTuple):
    """Receivers that get the same; `sees` is what that tells, in words."""

    receivers: tuple[ReportReceiver, ...]
    when: str
    fields: tuple[ReportFields, ...]
    sees: str = ""


class ReportTopic(NamedTuple):
    """A topic (or pattern) and all who receive it."""

    topic: str
    type: str
    groups: tuple[ReportGroup, ...]


def everything(_receiver: str, _field: str) -> bool:
    """The whole report."""
    return True


def topics(
    accesses: Iterable[ReceiverAccess],
    layout_of: Callable[[str], Layout],
    wanted: Wanted = everything,
    vocabulary: Vocabulary | None = None,
) -> list[ReportTopic]:
    """The report of these accesses, by topic; `vocabulary` is that of the policy."""
    by_topic: dict[tuple[str, str], dict[tuple[object, ...], list[ReportReceiver]]] = {}
    for access in sorted(_typed(accesses), key=lambda each: (each.topic, each.receiver, each.by)):
        fields = _fields(access, layout_of, wanted)
        if fields:
            groups = by_topic.setdefault((access.topic, access.type or ""), {})
            receiver = ReportReceiver(access.receiver, access.why, access.until, access.by)
            said = _sees(access, layout_of, vocabulary)
            groups.setdefault((_when(access), fields, said), []).append(receiver)
    return [
        ReportTopic(
            topic, kind, tuple(ReportGroup(tuple(who), *key) for key, who in groups.items())  # type: ignore[arg-type]
        )
        for (topic, kind), groups in by_topic.items()
    ]  # fmt: skip


def _typed(accesses: Iterable[ReceiverAccess]) -> list[ReceiverAccess]:
    """A topic is one, also where only some of its grants say the type of its messages."""
    found = list(accesses)
    kinds: dict[str, set[str]] = {}
    for each in found:
        kinds.setdefault(each.topic, set()).update({each.type} if each.type else ())
    return [
        replace(each, type=next(iter(kinds[each.topic])))
        if each.type is None and len(kinds[each.topic]) == 1
        else each
        for each in found
    ]


def held_accesses(
    held: Iterable[HeldGrant],
    types: Mapping[str, str],
    type_of: Callable[[str], str] = lambda _: "",
) -> list[ReceiverAccess]:
    """What is granted now, of every grant in force or ending.

    `types` by topic, from the graph; `type_of` is that of the policy, empty: it does not say.
    """
    found = []
    for each in held:
        for permission in each.grant.permissions:
            if each.is_over or Right.SUBSCRIBE not in permission.rights:
                continue
            restriction, topic = permission.restriction, permission.pattern
            kind = types.get(topic) or (restriction.type if restriction is not None else None)
            access = ReceiverAccess(
                topic, kind or type_of(topic) or None, each.grant.subject, _why(each),
                _until(each), f"grant {each.grant.short_id}",
                () if restriction is None else (restriction,),
                None if restriction is None else restriction.rate,
            )  # fmt: skip
            found.append(access)
    return found


def _why(held: HeldGrant) -> str:
    if held.is_ending:
        return "it was ended, and may still see it"
    return f"rule {held.view.rules} of the policy" if held.view.rules else "decided by hand"


def _until(held: HeldGrant) -> str:
    if held.is_ending:
        return "every node has heard"
    return words.day(max(held.grant.expires, held.view.cap))


def _fields(
    access: ReceiverAccess, layout_of: Callable[[str], Layout], wanted: Wanted
) -> tuple[ReportFields, ...]:
    rules = [rule for each in access.restrictions for rule in each.filters]
    by_treatment: dict[str, list[str]] = {}
    rest = f"everything {'else ' if rules else ''}in it"
    for path in _paths(access.type, layout_of, rules):
        if wanted(access.receiver, path):
            said = _treatment(filters_of(rules, path), access.type)
            by_treatment.setdefault(said, []).append(rest if path == WHOLE else path)
    found = [
        ReportFields(said, said == AS_IT_IS, tuple(paths)) for said, paths in by_treatment.items()
    ]
    return tuple(sorted(found, key=lambda each: not each.is_open))


def _sees(
    access: ReceiverAccess, layout_of: Callable[[str], Layout], vocabulary: Vocabulary | None
) -> str:
    """Nothing of a type that is not known here."""
    try:
        return "" if access.type is None else sees(access, layout_of(access.type), vocabulary)
    except (GrantError, MessageError):
        return ""


def _paths(
    kind: str | None, layout_of: Callable[[str], Layout], rules: list[FilterRule]
) -> list[str]:
    """The fields of the type; of one that is not known here those with a rule, and the rest."""
    try:
        if kind is not None:
            return leaf_paths(layout_of(kind)) or [WHOLE]
    except (GrantError, MessageError):
        pass
    return [*(rule.path for rule in rules), WHOLE]


def _treatment(rules: list[FilterRule], kind: str | None) -> str:
    said = [
        REMOVED if rule.operator in ("clear", "drop") else words.filter_rule(rule, kind)
        for rule in rules
    ]
    return ", then ".join(dict.fromkeys(said)) or AS_IT_IS


def _when(access: ReceiverAccess) -> str:
    parts = [text for each in access.restrictions for text in each.conditions]
    if access.rate is not None:
        parts.append(words.rate(access.rate))
    parts += [words.slot(each.slot) for each in access.restrictions if each.slot is not None]
    return " and ".join(dict.fromkeys(parts)) or "always"

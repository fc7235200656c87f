"""Who sees what: topics by receivers, from the grants of the record and the graph; and its report. Pure.

A cell never shows less than a node could see. What was ended may still be seen until every node has heard
(`Endings`), and no page says *ended* before. The report has the same accesses as `rossec privacy` prints
(`grants.policy.privacy`), in words, with receivers that are treated alike together.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from enum import StrEnum
from typing import Final, NamedTuple

from ca.names import TAIL, pattern_covers
from grants.document import peek
from grants.errors import GrantError
from grants.filters.layout import Layout
from grants.model import FilterRule, Grant, Permission, Restriction, Right, merge
from grants.policy.model import Vocabulary
from grants.policy.privacy import WHOLE, ReceiverAccess, leaf_paths, sees
from grants.vocabulary.assess import filters_of
from rossec.authority.console.messages import FactView, GrantView, ListProgress, NodeView
from rossec.console import words
from rossec.errors import MessageError
from rossec.peer_limits import printable

_ANY: Final = "anything_else"  # stands for a wildcard's segment; no node has such a name
AS_IT_IS: Final = "as it is"
REMOVED: Final = "removed"
STALE: Final = 300  # seconds after which no node without a session goes on, with some to spare


class Heard(NamedTuple):
    all: int = 0  # every node has what was ended before this time
    cut: int = 0  # no connection that ends with a stale list is left of what was ended before this one

    def has(self, ended_at: int, *, keeps: bool) -> bool:
        return ended_at < (self.all if keeps else max(self.all, self.cut))


class Endings:
    """What the master said of ends, remembered: one that does not answer now told it before."""

    def __init__(self) -> None:
        self.heard = Heard()

    def note(self, trust_status: ListProgress, asked_at: int) -> None:
        # A master that has not the list goes on confirming the old one.
        if not (trust_status.is_signed and trust_status.is_at_master):
            return
        every, cut = self.heard
        # A revocation is over when every node with a session has its list. A node without a session takes no
        # messages for long: its view of the list is stale within two minutes, and it cuts what does not
        # outlive that (`on_stale: keep`, grant.md section 4).
        if 0 < trust_status.nodes == trust_status.nodes_with_list:
            every = max(every, asked_at)
        elif not trust_status.nodes:
            cut = max(cut, asked_at - STALE)
        self.heard = Heard(every, cut)


class TopicAccess(StrEnum):
    ALL = "all"
    COARSE = "coarse"
    ENDING = "ending"  # it was ended, and not every node has heard
    ENDED = "ended"
    NOTHING = "nothing"


SEEING: Final = frozenset({TopicAccess.ALL, TopicAccess.COARSE, TopicAccess.ENDING})


class ShownGrant(NamedTuple):
    view: GrantView
    grant: Grant
    ended_at: int  # 0: it is in force
    reason: str  # why it is not
    is_ending: bool = False  # revoked, but somebody may not have heard of that: it may still be used

    @property
    def is_over(self) -> bool:
        return bool(self.ended_at) and not self.is_ending


class Cell(NamedTuple):
    receiver: str
    topic: str
    access: TopicAccess
    words: str = ""  # how it sees it (filters, conditions), or why that ended
    term: str = ""  # how long, or since when
    grants: tuple[bytes, ...] = ()  # ids, the one to show first
    restrictions: tuple[Restriction, ...] = ()  # of the widest grant
    sends: bool = False  # the receiver is itself a publisher of the topic

    @property
    def label(self) -> str:
        """The state in words; only conditions and a rate make no message coarse."""
        if self.access is TopicAccess.COARSE and not any(each.filters for each in self.restrictions):
            return "at times"
        return {"all": "all of it"}.get(self.access, str(self.access))


class TopicRow(NamedTuple):
    """A topic, or a pattern of topics, with one cell for each receiver of the matrix."""

    topic: str
    type: str  # of its messages; empty: not known
    publishers: tuple[str, ...]
    cells: tuple[Cell, ...]

    @property
    def is_pattern(self) -> bool:
        return _is_pattern(self.topic)

    def seen_by(self) -> list[Cell]:
        return [cell for cell in self.cells if cell.access in SEEING]


class Matrix(NamedTuple):
    receivers: tuple[str, ...]
    rows: tuple[TopicRow, ...]

    def row(self, topic: str) -> TopicRow | None:
        return next((row for row in self.rows if row.topic == topic), None)

    def window(self, rows: slice, receivers: slice) -> "Matrix":
        return Matrix(
            self.receivers[receivers],
            tuple(row._replace(cells=row.cells[receivers]) for row in self.rows[rows]),
        )

    def busiest_first(self) -> "Matrix":
        order = sorted(
            range(len(self.receivers)),
            key=lambda at: (-sum(row.cells[at].access is not TopicAccess.NOTHING for row in self.rows), at),
        )
        rows = [row._replace(cells=tuple(row.cells[at] for at in order)) for row in self.rows]
        rows.sort(key=lambda row: (row.is_pattern, -len(row.seen_by()), row.topic))
        return Matrix(tuple(self.receivers[at] for at in order), tuple(rows))


def held_grants(
    nodes: Iterable[NodeView], grants: Iterable[GrantView], now: int, heard: Heard
) -> tuple[ShownGrant, ...]:
    """Every grant with its end, newest first."""
    keys = {node.key: node for node in nodes}
    found = [_held(view, peek(view.data), keys, now, heard) for view in grants]
    return tuple(sorted(found, key=lambda held: (-held.view.at, held.view.id)))


def _held(view: GrantView, grant: Grant, keys: dict[bytes, NodeView], now: int, heard: Heard) -> ShownGrant:
    holder = keys.get(grant.holder)
    until = max(grant.expires, view.cap)  # one that the master may renew is in force until its cap
    given = [each.restriction for each in grant.permissions if each.restriction is not None]
    keeps = any(each.keep_when_stale for each in given)
    for ended in (view, holder):
        if ended is not None and ended.revoked_at:
            is_ending = until > now and not heard.has(ended.revoked_at, keeps=keeps)
            return ShownGrant(view, grant, ended.revoked_at, ended.reason, is_ending)
    if until <= now:
        return ShownGrant(view, grant, until, "its time was over")
    if holder is None:
        return ShownGrant(view, grant, view.at or 1, "the node has another key now")
    return ShownGrant(view, grant, 0, "")


def build(
    held: Sequence[ShownGrant],
    facts: Sequence[FactView],
    now: int,
    type_of: Callable[[str], str] = lambda _: "",
) -> Matrix:
    """The matrix of all topics that a grant or the graph names, and all nodes with a grant to see."""
    # The type of a topic by the policy (`type_of`) counts where neither of these says it.
    types = {fact.name: fact.node for fact in facts if fact.kind == "type"}
    topics = sorted(_topics(held, facts), key=lambda topic: (_is_pattern(topic), topic))
    sees = [each for each in held if any(Right.SUBSCRIBE in one.rights for one in each.grant.permissions)]
    receivers = sorted({each.grant.subject for each in sees})
    of = {name: [each for each in held if each.grant.subject == name] for name in receivers}
    rows = []
    for topic in topics:
        publishers = publishers_of(topic, held, facts)
        cells = tuple(_cell(name, topic, of[name], publishers, now) for name in receivers)
        granted = (each.type for cell in cells for each in cell.restrictions if each.type)
        kind = types.get(topic, "") or next(granted, "") or type_of(topic)
        rows.append(TopicRow(topic, kind, publishers, cells))
    return Matrix(tuple(receivers), tuple(rows))


def publishers_of(topic: str, held: Iterable[ShownGrant], facts: Iterable[FactView]) -> tuple[str, ...]:
    running = {fact.node for fact in facts if (fact.kind, fact.name) == ("publisher", topic)}
    granted = {
        each.grant.subject
        for each in held
        if not each.is_over and permissions_on(each.grant, Right.PUBLISH, topic)
    }
    return tuple(sorted(running | granted))


def permissions_on(grant: Grant, right: Right, topic: str) -> list[Permission]:
    named = topic.replace("**", _ANY).replace("*", _ANY).replace(TAIL, f"_{_ANY}")
    found = (each for each in grant.permissions if right in each.rights)
    return [each for each in found if pattern_covers(each.pattern, named)]


def _topics(held: Iterable[ShownGrant], facts: Iterable[FactView]) -> set[str]:
    running = {fact.name for fact in facts if fact.kind in ("publisher", "subscriber")}
    return running | {
        permission.pattern
        for each in held
        for permission in each.grant.permissions
        if permission.rights & (Right.SUBSCRIBE | Right.PUBLISH)
        and (not _is_pattern(permission.pattern) or Right.SUBSCRIBE in permission.rights)
    }


def _is_pattern(topic: str) -> bool:
    return "*" in topic or TAIL in topic


def _cell(receiver: str, topic: str, held: list[ShownGrant], publishers: tuple[str, ...], now: int) -> Cell:
    covering = [(each, permissions_on(each.grant, Right.SUBSCRIBE, topic)) for each in held]
    ways = [(each, found) for each, found in covering if found]
    # Grants of one node are alternatives, because it presents only those it chooses (`grants.decision`): one
    # of them without filters means `ALL`.
    cell = Cell(receiver, topic, TopicAccess.NOTHING, sends=receiver in publishers)
    if not ways:
        return cell
    possible = [(each, merge(one.restriction for one in found)) for each, found in ways if not each.is_over]
    living = [way for way in possible if not way[0].ended_at]
    ending = sorted((way for way in possible if way[0].is_ending), key=lambda way: _strictness(way[1]))
    # What is ending is said unless what stays shows as much.
    if ending and all(_strictness(ending[0][1]) < _strictness(given) for _, given in living):
        last, restrictions = ending[0]
        return cell._replace(
            access=TopicAccess.ENDING,
            words=printable(last.reason, 200),
            term=f"was ended {words.ago(last.ended_at, now)}; it may see it until every node has heard",
            grants=(last.view.id,),
            restrictions=restrictions,
        )
    if not living:
        last = max((each for each, _ in ways), key=lambda each: each.ended_at)
        return cell._replace(
            access=TopicAccess.ENDED,
            words=printable(last.reason, 200),
            term=f"ended {words.ago(last.ended_at, now)}",
            grants=(last.view.id,),
        )
    # The widest first: without restrictions, then fewer rules, then the longer term.
    living.sort(key=lambda way: (_strictness(way[1]), -way[0].view.cap, way[0].view.id))
    widest, restrictions = living[0]
    texts = dict.fromkeys(words.plain(given) for _, given in living)
    term = words.term(widest.grant.expires, widest.view.cap, now)
    if now < widest.grant.not_before:
        term = f"begins in {words.duration(widest.grant.not_before - now)}"
    return cell._replace(
        access=TopicAccess.COARSE if restrictions else TopicAccess.ALL,
        words=", or ".join(texts) if restrictions else "",
        term=term,
        grants=tuple(each.view.id for each, _ in living),
        restrictions=restrictions,
    )


def _strictness(restrictions: tuple[Restriction, ...]) -> int:
    return sum(len(each.filters) + len(each.conditions) + 1 for each in restrictions)


Wanted = Callable[[str, str], bool]
"""Whether a receiver's field is in the report."""


class ReportReceiver(NamedTuple):
    name: str
    why: str
    until: str
    by: str


class ReportFields(NamedTuple):
    treatment: str
    is_open: bool
    fields: tuple[str, ...]


class ReportGroup(NamedTuple):
    receivers: tuple[ReportReceiver, ...]
    when: str
    fields: tuple[ReportFields, ...]
    sees: str = ""


_Treated = tuple[str, tuple[ReportFields, ...], str]  # the rest of a group


class ReportTopic(NamedTuple):
    topic: str
    type: str
    groups: tuple[ReportGroup, ...]


def topics(
    accesses: Iterable[ReceiverAccess],
    layout_of: Callable[[str], Layout],
    wanted: Wanted = lambda _receiver, _field: True,
    vocabulary: Vocabulary | None = None,
) -> list[ReportTopic]:
    by_topic: dict[tuple[str, str], dict[_Treated, list[ReportReceiver]]] = {}
    for access in sorted(_typed(accesses), key=lambda each: (each.topic, each.receiver, each.by)):
        fields = _fields(access, layout_of, wanted)
        if fields:
            groups = by_topic.setdefault((access.topic, access.type or ""), {})
            receiver = ReportReceiver(access.receiver, access.why, access.until, access.by)
            said = ""
            with suppress(GrantError, MessageError):  # nothing of a type that is not known here
                said = "" if access.type is None else sees(access, layout_of(access.type), vocabulary)
            groups.setdefault((_when(access), fields, said), []).append(receiver)
    return [
        ReportTopic(*named, tuple(ReportGroup(tuple(who), *key) for key, who in groups.items()))
        for named, groups in by_topic.items()
    ]


def _typed(accesses: Iterable[ReceiverAccess]) -> list[ReceiverAccess]:
    # A topic is one, also where only some of its grants say the type of its messages.
    found = list(accesses)
    kinds: dict[str, set[str]] = {}
    for each in found:
        kinds.setdefault(each.topic, set()).update({each.type} if each.type else ())
    only = {topic: next(iter(given)) for topic, given in kinds.items() if len(given) == 1}
    return [replace(each, type=only.get(each.topic) if each.type is None else each.type) for each in found]


def held_accesses(
    held: Iterable[ShownGrant], types: Mapping[str, str], type_of: Callable[[str], str] = lambda _: ""
) -> list[ReceiverAccess]:
    """What is granted now, of every grant in force or ending; `types` are the graph's, by topic."""
    found = []
    for each in held:
        why = f"rule {each.view.rules} of the policy" if each.view.rules else "decided by hand"
        why = "it was ended, and may still see it" if each.is_ending else why
        end = words.day(max(each.grant.expires, each.view.cap))
        until = "every node has heard" if each.is_ending else end
        for permission in each.grant.permissions:
            if each.is_over or Right.SUBSCRIBE not in permission.rights:
                continue
            restriction, topic = permission.restriction, permission.pattern
            kind = types.get(topic) or (restriction.type if restriction is not None else None)
            access = ReceiverAccess(
                topic,
                kind or type_of(topic) or None,
                each.grant.subject,
                why,
                until,
                f"grant {each.grant.short_id}",
                () if restriction is None else (restriction,),
                None if restriction is None else restriction.rate,
            )
            found.append(access)
    return found


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
    found = [ReportFields(said, said == AS_IT_IS, tuple(paths)) for said, paths in by_treatment.items()]
    return tuple(sorted(found, key=lambda each: not each.is_open))


def _paths(kind: str | None, layout_of: Callable[[str], Layout], rules: list[FilterRule]) -> list[str]:
    # The fields of the type; of one that is not known here those with a rule, and the rest.
    with suppress(GrantError, MessageError):
        if kind is not None:
            return leaf_paths(layout_of(kind)) or [WHOLE]
    return [*(rule.path for rule in rules), WHOLE]


def _treatment(rules: list[FilterRule], kind: str | None) -> str:
    gone = ("clear", "drop")
    said = [REMOVED if rule.operator in gone else words.filter_rule(rule, kind) for rule in rules]
    return ", then ".join(dict.fromkeys(said)) or AS_IT_IS


def _when(access: ReceiverAccess) -> str:
    parts = [text for each in access.restrictions for text in each.conditions]
    if access.rate is not None:
        parts.append(words.rate(access.rate))
    parts += [words.slot(each.slot) for each in access.restrictions if each.slot is not None]
    return " and ".join(dict.fromkeys(parts)) or "always"

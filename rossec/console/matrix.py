"""Who sees what: topics by receivers, from the grants of the record and the graph. Pure.

A cell never shows less than a node could see. Grants of one node are alternatives, because it
presents only those it chooses (`grants.decision`): one of them without filters means `ALL`. A grant
that the master may renew counts as in force until its cap.
"""

from collections.abc import Callable, Iterable, Sequence
from enum import StrEnum
from typing import Final, NamedTuple

from ca.patterns import TAIL, covers
from grants.document import peek
from grants.model import Grant, Permission, Restriction, Right, merge
from rossec.authority.console.views import FactView, GrantView, NodeView
from rossec.console import words
from rossec.console.endings import Heard
from rossec.ros.text import printable

_ANY: Final = "anything_else"  # stands for a wildcard's segment; no node has such a name


class Access(StrEnum):
    """How much a receiver sees of a topic."""

    ALL = "all"
    COARSE = "coarse"
    ENDING = "ending"  # it was ended, and not every node has heard
    ENDED = "ended"
    NOTHING = "nothing"


SEEING: Final = frozenset({Access.ALL, Access.COARSE, Access.ENDING})


class HeldGrant(NamedTuple):
    """A grant and whether it is in force: `ended_at` is 0 if it is, `reason` why it is not.

    `is_ending`: it was revoked, and somebody may not have heard of that: it may still be used.
    """

    view: GrantView
    grant: Grant
    ended_at: int
    reason: str
    is_ending: bool = False

    @property
    def is_over(self) -> bool:
        """Whether nobody can use it any more."""
        return bool(self.ended_at) and not self.is_ending


class Cell(NamedTuple):
    """What one receiver sees of one topic.

    `words` is how (filters, conditions) or why it ended, `term` how long or since when; `grants`
    are ids, the one to show first; `restrictions` those of the widest grant; `sends`: the receiver
    is itself a publisher of the topic.
    """

    receiver: str
    topic: str
    access: Access
    words: str = ""
    term: str = ""
    grants: tuple[bytes, ...] = ()
    restrictions: tuple[Restriction, ...] = ()
    sends: bool = False

    @property
    def label(self) -> str:
        """The state in words; only conditions and a rate make no message coarse."""
        if self.access is Access.COARSE and not any(each.filters for each in self.restrictions):
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
        """Whether it stands for all topics that it covers."""
        return _is_pattern(self.topic)

    def seen_by(self) -> list[Cell]:
        """The cells of receivers that see something now, or may still."""
        return [cell for cell in self.cells if cell.access in SEEING]


class Matrix(NamedTuple):
    """The whole matrix; receivers and rows are sorted by name."""

    receivers: tuple[str, ...]
    rows: tuple[TopicRow, ...]

    def row(self, topic: str) -> TopicRow | None:
        """The row of a topic, if it has one."""
        return next((row for row in self.rows if row.topic == topic), None)

    def window(self, rows: slice, receivers: slice) -> "Matrix":
        """A part of it: a page shows only so much."""
        return Matrix(
            self.receivers[receivers],
            tuple(row._replace(cells=row.cells[receivers]) for row in self.rows[rows]),
        )

    def busiest_first(self) -> "Matrix":
        """The same, with the rows and receivers first in which most is seen."""
        order = sorted(
            range(len(self.receivers)),
            key=lambda at: (
                -sum(row.cells[at].access is not Access.NOTHING for row in self.rows),
                at,
            ),
        )
        rows = [row._replace(cells=tuple(row.cells[at] for at in order)) for row in self.rows]
        rows.sort(key=lambda row: (row.is_pattern, -len(row.seen_by()), row.topic))
        return Matrix(tuple(self.receivers[at] for at in order), tuple(rows))


def held_grants(
    nodes: Iterable[NodeView], grants: Iterable[GrantView], now: int, heard: Heard
) -> tuple[HeldGrant, ...]:
    """Every grant with its end, newest first; `heard`: what every node knows to have ended.

    Raises:
        GrantMalformed: the record has one that cannot be read.
    """
    keys = {node.key: node for node in nodes}
    found = [_held(view, peek(view.data), keys, now, heard) for view in grants]
    return tuple(sorted(found, key=lambda held: (-held.view.at, held.view.id)))


def _held(
    view: GrantView, grant: Grant, keys: dict[bytes, NodeView], now: int, heard: Heard
) -> HeldGrant:
    holder = keys.get(grant.holder)
    until = max(grant.expires, view.cap)
    keeps = any(
        each.restriction is not None and each.restriction.keep_when_stale
        for each in grant.permissions
    )
    for ended in (view, holder):
        if ended is not None and ended.revoked_at:
            is_ending = until > now and not heard.has(ended.revoked_at, keeps=keeps)
            return HeldGrant(view, grant, ended.revoked_at, ended.reason, is_ending)
    if until <= now:
        return HeldGrant(view, grant, until, "its time was over")
    if holder is None:
        return HeldGrant(view, grant, view.at or 1, "the node has another key now")
    return HeldGrant(view, grant, 0, "")


def build(
    held: Sequence[HeldGrant],
    facts: Sequence[FactView],
    now: int,
    type_of: Callable[[str], str] = lambda _: "",
) -> Matrix:
    """The matrix of all topics that a grant or the graph names, and all nodes with a grant to see.

    Args:
        held: from `held_grants`.
        facts: of the graph; empty if there is no master.
        now: seconds since the epoch.
        type_of: the type of a topic by the policy, where neither of these says it; empty: no word.
    """
    types = {fact.name: fact.node for fact in facts if fact.kind == "type"}
    topics = sorted(_topics(held, facts), key=lambda topic: (_is_pattern(topic), topic))
    receivers = sorted({each.grant.subject for each in held if _sees(each.grant)})
    of = {name: [each for each in held if each.grant.subject == name] for name in receivers}
    rows = []
    for topic in topics:
        publishers = publishers_of(topic, held, facts)
        cells = tuple(_cell(name, topic, of[name], publishers, now) for name in receivers)
        kind = types.get(topic, "") or _granted_type(cells) or type_of(topic)
        rows.append(TopicRow(topic, kind, publishers, cells))
    return Matrix(tuple(receivers), tuple(rows))


def publishers_of(
    topic: str, held: Iterable[HeldGrant], facts: Iterable[FactView]
) -> tuple[str, ...]:
    """The nodes that send a topic: by the graph, and by grants in force."""
    running = {fact.node for fact in facts if (fact.kind, fact.name) == ("publisher", topic)}
    granted = {
        each.grant.subject for each in held
        if not each.is_over and permissions_on(each.grant, Right.PUBLISH, topic)
    }  # fmt: skip
    return tuple(sorted(running | granted))


def permissions_on(grant: Grant, right: Right, topic: str) -> list[Permission]:
    """The permissions that give `right` on a topic, or on all that the pattern `topic` covers."""
    named = topic.replace("**", _ANY).replace("*", _ANY).replace(TAIL, f"_{_ANY}")
    return [
        each for each in grant.permissions if right in each.rights and covers(each.pattern, named)
    ]


def _sees(grant: Grant) -> bool:
    return any(Right.SUBSCRIBE in each.rights for each in grant.permissions)


def _topics(held: Iterable[HeldGrant], facts: Iterable[FactView]) -> set[str]:
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


def _granted_type(cells: Iterable[Cell]) -> str:
    kinds = (each.type for cell in cells for each in cell.restrictions)
    return next((kind for kind in kinds if kind), "")


def _cell(
    receiver: str, topic: str, held: list[HeldGrant], publishers: tuple[str, ...], now: int
) -> Cell:
    covering = [(each, permissions_on(each.grant, Right.SUBSCRIBE, topic)) for each in held]
    ways = [(each, found) for each, found in covering if found]
    cell = Cell(receiver, topic, Access.NOTHING, sends=receiver in publishers)
    if not ways:
        return cell
    possible = [(each, merge(one.restriction for one in found)) for each, found in ways
                if not each.is_over]  # fmt: skip
    living = [way for way in possible if not way[0].ended_at]
    ending = sorted(
        (way for way in possible if way[0].is_ending), key=lambda way: _strictness(way[1])
    )
    # What is ending is said unless what stays shows as much.
    if ending and all(_strictness(ending[0][1]) < _strictness(given) for _, given in living):
        return _ending_cell(cell, *ending[0], now)
    if not living:
        last = max((each for each, _ in ways), key=lambda each: each.ended_at)
        return cell._replace(
            access=Access.ENDED,
            words=printable(last.reason, 200),
            term=f"ended {words.ago(last.ended_at, now)}",
            grants=(last.view.id,),
        )
    # The widest first: without restrictions, then fewer rules, then the longer term.
    living.sort(key=lambda way: (_strictness(way[1]), -way[0].view.cap, way[0].view.id))
    widest, restrictions = living[0]
    texts = dict.fromkeys(words.plain(given) for _, given in living)
    return cell._replace(
        access=Access.COARSE if restrictions else Access.ALL,
        words=", or ".join(texts) if restrictions else "",
        term=_term(widest, now),
        grants=tuple(each.view.id for each, _ in living),
        restrictions=restrictions,
    )


def _ending_cell(
    cell: Cell, held: HeldGrant, restrictions: tuple[Restriction, ...], now: int
) -> Cell:
    return cell._replace(
        access=Access.ENDING,
        words=printable(held.reason, 200),
        term=f"was ended {words.ago(held.ended_at, now)}; it may see it until every node has heard",
        grants=(held.view.id,),
        restrictions=restrictions,
    )


def _strictness(restrictions: tuple[Restriction, ...]) -> int:
    return sum(len(each.filters) + len(each.conditions) + 1 for each in restrictions)


def _term(held: HeldGrant, now: int) -> str:
    if now < held.grant.not_before:
        return f"begins in {words.duration(held.grant.not_before - now)}"
    return words.term(held.grant.expires, held.view.cap, now)

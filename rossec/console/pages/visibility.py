"""Who sees what: the matrix, one topic as each receiver sees it, a node, a grant; and the report to print.

Most pages begin with the same `load`: nodes, grants and the graph, asked of the service, as a matrix. Without
a master there is no graph and there are no denials: pages show the rest and say so. `rossec privacy --html`
writes the report from the policy, as a file of its own (`write`).
"""

import logging
from collections.abc import Sequence
from contextlib import suppress
from typing import Any, Final, NamedTuple

from starlette.responses import Response

from ca.errors import HintedError, PatternRefused
from ca.names import check_pattern, is_master_name
from grants.model import Right
from rossec.authority.console.messages import DenialView, FactView, GrantQuestion, NodeView
from rossec.console import samples, words
from rossec.console.matrix import (
    Cell,
    Heard,
    Matrix,
    ReportTopic,
    ShownGrant,
    TopicAccess,
    TopicRow,
    build,
    held_accesses,
    held_grants,
    topics,
)
from rossec.console.pictures import looks
from rossec.console.rendering import STATIC_FOLDER, PageList, Visit, render_text
from rossec.console.sentences import KnownIds, SentencePart, permission, permissions, story
from rossec.errors import HttpRefused, KeyServiceFailed
from rossec.participant.host_types import layout_of
from rossec.peer_limits import printable

PAGES: Final = PageList()
MAX_REFUSED: Final = 12
AGAIN: Final = 5  # seconds after which a page looks again at what is ending
_log = logging.getLogger("rossec.console")


class Overview(NamedTuple):
    nodes: tuple[NodeView, ...]
    held: tuple[ShownGrant, ...]
    facts: tuple[FactView, ...]
    matrix: Matrix
    without_master: bool  # it does not answer, so there is no graph
    heard: Heard
    now: int

    @property
    def ending(self) -> frozenset[str]:
        grants = [each for each in self.held if each.is_ending]
        keys = {each.grant.holder for each in grants}
        # An identity as a grant: revoked, not over by itself, and not every node has the list that says so.
        nodes = {
            each.key.hex()
            for each in self.nodes
            if each.revoked_at
            and each.not_after > self.now
            and (each.key in keys or not self.heard.has(each.revoked_at, keeps=False))
        }
        return frozenset({each.view.id.hex() for each in grants} | nodes)

    def named(self, name: str) -> list[NodeView]:
        found = [node for node in self.nodes if node.name == name]
        return sorted(found, key=lambda node: -node.not_before)


async def load(visit: Visit) -> Overview:
    now, endings = visit.context.clock(), visit.context.endings
    nodes, grants = await visit.service.nodes(), await visit.service.grants()
    facts: tuple[FactView, ...] = ()
    without_master = False
    try:
        facts = await visit.service.graph()
    except HintedError as error:
        _log.info("there is no graph: %s", printable(error))
        without_master = True

    def view() -> Overview:
        held = held_grants(nodes, grants, now, endings.heard)
        # The policy has the types of topics that the graph and the grants do not tell.
        matrix = build(held, facts, now, visit.names.type_of)
        return Overview(nodes, held, facts, matrix, without_master, endings.heard, now)

    found = view()
    if not found.ending or without_master:
        return found
    with suppress(HintedError):  # then it is not known, and said to be ending
        endings.note(await visit.service.trust_status(0, 0), now)
    return view()


def again(home: Overview) -> int:
    """In how many seconds the page looks again; 0: when something has changed."""
    return AGAIN if home.ending and not home.without_master else 0


def render_home(visit: Visit, home: Overview, template: str, **values: Any) -> Response:
    """A page of the home, which looks again while something is ending."""
    state = {"live": True, "without_master": home.without_master, "again": again(home)}
    return visit.show(template, **(state | values))


async def denials(visit: Visit) -> tuple[DenialView, ...]:
    try:
        return await visit.service.denials()
    except HintedError:
        return ()


async def questions(visit: Visit) -> tuple[tuple[GrantQuestion, ...], str]:
    """What nodes ask for, and why that is not known: the policy cannot be used; empty: it is."""
    try:
        return await visit.service.questions(), ""
    except KeyServiceFailed:  # no fault of the policy: no page can be shown
        raise
    except HintedError as error:
        return (), str(error)


def refused_names(found: tuple[DenialView, ...]) -> dict[str, list[str]]:
    names: dict[str, list[str]] = {}
    for denial in sorted(found, key=lambda each: -each.at):
        known = names.setdefault(denial.node, []) if len(names) < MAX_REFUSED else names.get(denial.node, [])
        if denial.name not in known:
            known.append(denial.name)
    return names


def comparison(visit: Visit, row: TopicRow) -> looks.Comparison | None:
    """What the topic looks like to its receivers: by the preview, else made up; None: unknown."""
    if not row.type or row.is_pattern or not row.seen_by():
        return None
    applied = [each for cell in row.seen_by() for each in cell.restrictions]
    recorded = samples.recorded(row.topic, row.type, applied, visit.context.preview)
    found = None if recorded is None else looks.compare(recorded, row.cells)
    return found if found is not None and found.looks else None


def name_of(text: str) -> str:
    try:
        return check_pattern(f"/{text}")
    except PatternRefused as error:
        raise HttpRefused("there is no such page", error.hint, status=404) from None


def position(text: str | None) -> int:
    if not text:
        return 0
    # Digits of other scripts are decimal too, and `int` of a long text takes the square of its time.
    if not (text.isascii() and text.isdecimal() and len(text) <= 12):
        raise HttpRefused("there is no such page", "go back to the first", status=404)
    return int(text)


ROWS: Final = 12
RECEIVERS: Final = 4
MAX_OTHERS: Final = 60
MAX_CELLS: Final = 40
_OTHER: Final = ~(Right.SUBSCRIBE | Right.PUBLISH)


class OtherRight(NamedTuple):
    node: str
    what: str
    pattern: str
    grant: bytes


@PAGES.get("/who")
async def show_who(visit: Visit) -> Response:
    home = await load(visit)
    row = position(visit.query.get("row"))
    receiver = position(visit.query.get("receiver"))
    part = home.matrix.window(slice(row, row + ROWS), slice(receiver, receiver + RECEIVERS))
    others = other_rights(home.held)
    return render_home(
        visit,
        home,
        "who.html",
        matrix=part,
        row=row,
        receiver=receiver,
        rows=len(home.matrix.rows),
        receivers=len(home.matrix.receivers),
        page_rows=ROWS,
        page_receivers=RECEIVERS,
        others=others[:MAX_OTHERS],
        more=max(0, len(others) - MAX_OTHERS),
    )


def other_rights(held: tuple[ShownGrant, ...]) -> list[OtherRight]:
    found = [
        OtherRight(
            each.grant.subject,
            "still " * each.is_ending + words.rights(permission.rights & _OTHER),
            words.topic(permission.pattern),
            each.view.id,
        )
        for each in held
        for permission in each.grant.permissions
        if not each.is_over and permission.rights & _OTHER
    ]
    return sorted(set(found))


@PAGES.get("/see/{topic:path}")
async def see(visit: Visit) -> Response:
    name = name_of(visit.path["topic"])
    home = await load(visit)
    row = home.matrix.row(name)
    if row is None:
        raise HttpRefused(f"no grant and no node names {words.name(name)}", "see who sees what", status=404)
    cells = sorted(row.cells, key=lambda cell: ([*TopicAccess].index(cell.access), cell.receiver))
    return render_home(
        visit,
        home,
        "see.html",
        row=row,
        cells=cells[:MAX_CELLS],
        more=max(0, len(cells) - MAX_CELLS),
        comparison=comparison(visit, row),
    )


MAX_ROWS: Final = 40
MAX_GRANTS: Final = 30
THINGS: Final = 6
_ENTRIES: Final = 200


class GrantLine(NamedTuple):
    id: bytes
    parts: tuple[SentencePart, ...]
    term: str
    ended: bool
    reason: str
    ending: bool = False


class PermissionLine(NamedTuple):
    parts: tuple[SentencePart, ...]
    words: str
    exact: tuple[str, ...]


@PAGES.get("/node/{name:path}")
async def show_node(visit: Visit) -> Response:
    name = name_of(visit.path["name"])
    home = await load(visit)
    identities = home.named(name)
    if not identities:
        raise HttpRefused(f"no node has the name {words.name(name)}", "see who sees what", status=404)
    now = visit.context.clock()
    grants = [grant_line(each, now) for each in home.held if each.grant.subject == name]
    grants.sort(key=lambda line: line.ended)
    seen = sees(home.matrix, name)
    sent = [row for row in home.matrix.rows if name in row.publishers]
    events = await visit.service.events(0, _ENTRIES)
    known = KnownIds.of(home.held, home.nodes, ending=home.ending)
    told = [each for each in story(events, await denials(visit), known) if each.node == name]
    return render_home(
        visit,
        home,
        "node.html",
        name=name,
        identities=identities,
        seen=seen[:MAX_ROWS],
        sent=sent[:MAX_ROWS],
        grants=grants[:MAX_GRANTS],
        more_seen=max(0, len(seen) - MAX_ROWS),
        more_sent=max(0, len(sent) - MAX_ROWS),
        more_grants=max(0, len(grants) - MAX_GRANTS),
        sentences=told[:THINGS],
        is_master=is_master_name(name),
        is_ending=identities[0].key.hex() in home.ending,
    )


def sees(matrix: Matrix, name: str) -> list[tuple[TopicRow, Cell]]:
    found = [
        (row, cell)
        for row in matrix.rows
        for cell in row.cells
        if cell.receiver == name and cell.access is not TopicAccess.NOTHING
    ]
    return sorted(found, key=lambda item: (item[1].access is TopicAccess.ENDED, item[0].topic))


def grant_line(held: ShownGrant, now: int) -> GrantLine:
    term = words.term(held.grant.expires, held.view.cap, now)
    if held.ended_at:
        term = f"ended {words.ago(held.ended_at, now)}"
    if held.is_ending:
        term = f"was ended {words.ago(held.ended_at, now)}, and not every node has heard"
    given = permissions(held.grant.permissions)
    return GrantLine(held.view.id, given, term, bool(held.ended_at), held.reason, held.is_ending)


@PAGES.get("/grant/{id}")
async def grant(visit: Visit) -> Response:
    number = visit.id
    home = await load(visit)
    held = next((each for each in home.held if each.view.id == number), None)
    if held is None:
        raise HttpRefused("there is no such grant in the last 30 days", "see who sees what", status=404)
    lines = [
        PermissionLine(
            permission(each), words.restrictions(filter(None, [each.restriction])), tuple(each.lines())
        )
        for each in held.grant.permissions
    ]
    return render_home(
        visit,
        home,
        "grant.html",
        held=held,
        lines=lines,
        line=grant_line(held, visit.context.clock()),
        holder=any(node.key == held.grant.holder and not node.revoked_at for node in home.nodes),
    )


TOPICS: Final = 12  # on one page


@PAGES.get("/privacy")
async def show_privacy(visit: Visit) -> Response:
    home = await load(visit)
    first = position(visit.query.get("row"))
    types = {fact.name: fact.node for fact in home.facts if fact.kind == "type"}
    found = topics(held_accesses(home.held, types, visit.names.type_of), layout_of)
    return render_home(
        visit,
        home,
        "privacy.html",
        topics=found[first : first + TOPICS],
        row=first,
        rows=len(found),
        page_rows=TOPICS,
    )


def write(found: Sequence[ReportTopic], robot: str, now: int, names: words.Names = words.NONE) -> str:
    style = (STATIC_FOLDER / "style.css").read_text(encoding="utf-8")
    values = {"topics": found, "robot": robot, "now": now, "style": style}
    return render_text("report_alone.html", names, **values)

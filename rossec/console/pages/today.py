"""Today: what waits for an answer, who sees what, what it looks like; what happened; and the data flow, live.

`/news` tells pages that are open that something changed, as server-sent events.
"""

import math
from collections.abc import Iterable
from contextlib import suppress
from typing import Any, Final, NamedTuple
from urllib.parse import urlencode

from starlette.responses import Response, StreamingResponse

from ca.approvals.passkeys import base64url
from ca.errors import HintedError
from grants.model import Permission, Right
from rossec.authority.console.messages import EventView, GrantQuestion
from rossec.console import approvals
from rossec.console.matrix import Matrix, TopicAccess, TopicRow
from rossec.console.pages import visibility
from rossec.console.pictures import flow, place
from rossec.console.rendering import PageList, Visit
from rossec.console.sentences import KnownIds, SentencePart, permissions, refusals, say, story

PAGES: Final = PageList()
ROWS: Final = 8
RECEIVERS: Final = 4
LOOKS: Final = 2
THINGS: Final = 9
_ENTRIES: Final = 60  # of the log, of which some have no sentence of their own
_IN_PART: Final = "Some of the policy is not in force"


class WaitingQuestion(NamedTuple):
    parts: tuple[SentencePart, ...]
    path: str
    at: int
    why: str = ""  # the node's own words
    acts: bool = False  # it would do something, not only see it


class TodayCounts(NamedTuple):
    senders: int
    topics: int
    receivers: int


@PAGES.get("/")
async def show_today(visit: Visit) -> Response:
    home = await visibility.load(visit)
    questions, without_policy = await visibility.questions(visit)
    denied = await visibility.denials(visit)
    events = await visit.service.events(0, _ENTRIES)
    known = KnownIds.of(home.held, home.nodes, questions, home.ending)
    told = [each for each in story(events, denied, known) if each.tone != "note"]
    seen = visit.session.seen  # the last entry that this session saw in the log
    busy = home.matrix.busiest_first()
    part = busy.window(slice(ROWS), slice(RECEIVERS))
    return visibility.render_home(
        visit,
        home,
        "today.html",
        authority=await visit.service.status(),
        waiting=await _waiting(visit, questions),
        counts=counts(home.matrix),
        matrix=part,
        rows=len(busy.rows),
        receivers=len(busy.receivers),
        silent=len({node.name for node in home.nodes if not node.revoked_at} - _looking(home.matrix)),
        **_looks(visit, busy),
        flow=flow.draw(part, visibility.refused_names(denied), visit.names.title),
        sentences=told[:THINGS],
        ending=len(home.ending),
        new=0 if seen is None else sum(each.number > seen for each in told),
        without_policy=without_policy,
    )


async def _waiting(visit: Visit, questions: Iterable[GrantQuestion]) -> list[WaitingQuestion]:
    found = []
    for question in questions:
        rights = [Permission(each.pattern, Right(each.right)) for each in question.rights]
        drives = any(approvals.drives(each) for each in question.rights)
        asks = "asks to drive, to" if drives else "asks to"
        said = say(SentencePart(question.node, is_name=True), asks, *permissions(rights))
        where, acts = f"/ask/{base64url(question.id)}", approvals.acts(question.rights)
        found.append(WaitingQuestion(said, where, question.at, question.why, acts))
    for each in await visit.service.identity_requests():
        if each.state == "pending":
            said = say(SentencePart(each.name, is_name=True), "asks to join")
            found.append(WaitingQuestion(said, f"/join/{base64url(each.id)}", each.arrived))
    now = visit.context.clock()
    phones = await visit.service.proposals()
    found += [WaitingQuestion(say(each.name, "wants to approve, too"), "/phones", now) for each in phones]
    with suppress(HintedError):  # a policy that cannot be read is told on its own page
        policy = await visit.service.policy()
        if policy.mistakes or policy.gives or policy.takes or policy.refused:
            told = "The policy has changed" if policy.gives or policy.takes else _IN_PART
            told = "The policy has mistakes" if policy.mistakes else told
            found.append(WaitingQuestion(say(told), "/policy", now))
    return sorted(found, key=lambda each: each.at)


def counts(matrix: Matrix) -> TodayCounts:
    sent = [row for row in matrix.rows if row.publishers]
    senders = {name for row in sent for name in row.publishers}
    return TodayCounts(len(senders), len(sent), len(_looking(matrix)))


def _looking(matrix: Matrix) -> set[str]:
    return {cell.receiver for row in matrix.rows for cell in row.seen_by()}


def _looks(visit: Visit, matrix: Matrix) -> dict[str, Any]:
    # `moving` is the node whose place it is, if it is one's.
    def contrast(row: TopicRow) -> tuple[bool, bool, int]:
        states = {cell.access for cell in row.seen_by()}
        return states == {TopicAccess.ALL, TopicAccess.COARSE}, place.has_place(row.type), len(states)

    for row in sorted(matrix.rows, key=contrast, reverse=True):
        found = visibility.comparison(visit, row)
        if found is not None:
            one = len(row.publishers) == 1 and place.has_place(row.type)
            moving = row.publishers[0] if one else ""
            return {"comparison": found._replace(looks=found.looks[:LOOKS]), "moving": moving}
    return {"comparison": None, "moving": ""}


HAPPENED_THINGS: Final = 50
MAX_REFUSED: Final = 20  # sentences about denials on one page
_HAPPENED_ENTRIES: Final = 100  # asked at once
_ROUNDS: Final = 10  # of asking, where few entries are of the node that is looked for


@PAGES.get("/log")
async def log(visit: Visit) -> Response:
    before = visibility.position(visit.query.get("before"))
    text = visit.query.get("node", "")
    node = visibility.name_of(text[1:]) if text else ""
    home = await visibility.load(visit)
    questions = (await visibility.questions(visit))[0]
    known = KnownIds.of(home.held, home.nodes, questions, home.ending)
    events, following = await _events(visit, before, node, known)
    times = [event.at for event in events] or [0]
    first, end = min(times) if following else 0, max(times) if before else math.inf
    denied = [each for each in await visibility.denials(visit) if first <= each.at < end]
    told = [each for each in story(events, denied, known) if not node or each.node == node]
    # At most so many denials, the newest, and how many are left out: nodes cause them at will.
    refused = set([each for each in told if each.number < 0][MAX_REFUSED:])
    told = [each for each in told if each not in refused]
    fresh, seen = 0, visit.session.seen
    if not before:
        fresh = 0 if seen is None else sum(each.number > seen for each in told)
        if events:
            visit.session.seen = max(seen or 0, *(event.number for event in events))
    more = urlencode({"before": following, **({"node": node} if node else {})})
    return visit.show(
        "log.html",
        live=not before,
        sentences=told,
        node=node,
        before=before,
        more=f"/log?{more}" if following else "",
        new=fresh,
        more_refused=len(refused),
        without_master=home.without_master,
        again=0 if before else visibility.again(home),
    )


async def _events(visit: Visit, before: int, node: str, known: KnownIds) -> tuple[list[EventView], int]:
    found: list[EventView] = []
    following = before
    for _ in range(_ROUNDS):
        part = await visit.service.events(following, _HAPPENED_ENTRIES)
        for event in part:
            found.append(event)
            following = event.number
            told = story(found, (), known)
            if len([each for each in told if not node or each.node == node]) >= HAPPENED_THINGS:
                return found, following
        if len(part) < _HAPPENED_ENTRIES:
            return found, 0
    return found, following


@PAGES.get("/way")
async def way(visit: Visit) -> Response:
    home = await visibility.load(visit)
    row = visibility.position(visit.query.get("row"))
    denied = await visibility.denials(visit)
    busy = home.matrix.busiest_first()
    part = busy.window(slice(row, row + flow.MAX_ROWS), slice(flow.MAX_ROWS))
    told = refusals(denied)
    running = {fact.name for fact in home.facts if fact.kind == "publisher"}
    return visibility.render_home(
        visit,
        home,
        "way.html",
        row=row,
        rows=len(busy.rows),
        page_rows=flow.MAX_ROWS,
        shown=busy.rows[row : row + flow.MAX_ROWS],
        flow=flow.draw(part, visibility.refused_names(denied), visit.names.title),
        running=running,
        refused=sorted(told, key=lambda each: -each.at)[:MAX_REFUSED],
        more_refused=max(0, len(told) - MAX_REFUSED),
    )


@PAGES.get("/news")
async def stream(visit: Visit) -> Response:
    session = visit.session
    is_valid = lambda: visit.context.sessions.is_valid(session, visit.context.elapsed())  # noqa: E731 - one expression
    return StreamingResponse(visit.context.news.open(is_valid), media_type="text/event-stream")

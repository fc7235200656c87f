"""Today: what waits for an answer, who sees what, what it looks like; what happened; and the data flow, live.

`/news` tells pages that are open that something changed, as server-sent events.
"""

import math
from collections.abc import Iterable
from contextlib import suppress
from typing import Any, Final, NamedTuple
from urllib.parse import urlencode

from starlette.requests import Request
from starlette.responses import Response, StreamingResponse

from ca.errors import HintedError
from grants.model import Permission, Right
from rossec.authority.console.messages import EventView, GrantQuestion
from rossec.console import approvals
from rossec.console.context import ConsoleContext
from rossec.console.matrix import Matrix, TopicAccess, TopicRow
from rossec.console.pages import visibility
from rossec.console.pages.visibility import Overview
from rossec.console.pictures import flow, place
from rossec.console.rendering import Page, names_of, render, to_base64url
from rossec.console.sentences import KnownIds, SentencePart, permissions, refusals, story

ROWS: Final = 8
RECEIVERS: Final = 4
LOOKS: Final = 2
THINGS: Final = 9
_ENTRIES: Final = 60  # of the log, of which some have no sentence of their own
_IN_PART: Final = "Some of the policy is not in force"


class WaitingQuestion(NamedTuple):
    """A question that waits: a sentence, its page, and since when."""

    parts: tuple[SentencePart, ...]
    path: str
    at: int
    why: str = ""  # the node's own words
    acts: bool = False  # it would do something, not only see it


class TodayCounts(NamedTuple):
    senders: int
    topics: int
    receivers: int


async def show_today(request: Request, context: ConsoleContext) -> Response:
    home = await visibility.load(context, names_of(request))
    questions, without_policy = await visibility.questions(context)
    denied = await visibility.denials(context)
    events = await context.service.events(0, _ENTRIES)
    known = KnownIds.of(home.held, home.nodes, questions, home.ending)
    told = [each for each in story(events, denied, known) if each.tone != "note"]
    seen = request.state.session.seen  # the last entry that this session saw in the log
    busy = home.matrix.busiest_first()
    part = busy.window(slice(ROWS), slice(RECEIVERS))
    return visibility.render_home(
        context,
        request,
        home,
        "today.html",
        authority=await context.service.status(),
        waiting=await _waiting(context, questions),
        counts=counts(home.matrix),
        matrix=part,
        rows=len(busy.rows),
        receivers=len(busy.receivers),
        silent=silent(home),
        **_looks(context, busy),
        flow=flow.draw(part, visibility.refused_names(denied), names_of(request).title),
        sentences=told[:THINGS],
        ending=len(home.ending),
        new=0 if seen is None else sum(each.number > seen for each in told),
        without_policy=without_policy,
    )


async def _waiting(context: ConsoleContext, questions: Iterable[GrantQuestion]) -> list[WaitingQuestion]:
    found = [
        WaitingQuestion(
            _asked(each), f"/ask/{to_base64url(each.id)}", each.at, each.why, approvals.acts(each.rights)
        )
        for each in questions
    ]
    found += [
        WaitingQuestion(
            (SentencePart(each.name, is_name=True), SentencePart("asks to join")),
            f"/join/{to_base64url(each.id)}",
            each.arrived,
        )
        for each in await context.service.identity_requests()
        if each.state == "pending"
    ]
    found += [
        WaitingQuestion(
            (SentencePart(each.name), SentencePart("wants to approve, too")), "/phones", context.clock()
        )
        for each in await context.service.proposals()
    ]
    with suppress(HintedError):  # a policy that cannot be read is told on its own page
        policy = await context.service.policy()
        if policy.mistakes or policy.gives or policy.takes or policy.refused:
            said = "The policy has changed" if policy.gives or policy.takes else _IN_PART
            said = "The policy has mistakes" if policy.mistakes else said
            found.append(WaitingQuestion((SentencePart(said),), "/policy", context.clock()))
    return sorted(found, key=lambda each: each.at)


def _asked(question: GrantQuestion) -> tuple[SentencePart, ...]:
    rights = [Permission(each.pattern, Right(each.right)) for each in question.rights]
    drives = any(approvals.drives(each) for each in question.rights)
    asks = SentencePart("asks to drive, to" if drives else "asks to")
    return SentencePart(question.node, is_name=True), asks, *permissions(rights)


def counts(matrix: Matrix) -> TodayCounts:
    sent = [row for row in matrix.rows if row.publishers]
    senders = {name for row in sent for name in row.publishers}
    looking = {cell.receiver for row in matrix.rows for cell in row.seen_by()}
    return TodayCounts(len(senders), len(sent), len(looking))


def silent(home: Overview) -> int:
    looking = {cell.receiver for row in home.matrix.rows for cell in row.seen_by()}
    return len({node.name for node in home.nodes if not node.revoked_at} - looking)


def _looks(context: ConsoleContext, matrix: Matrix) -> dict[str, Any]:
    # `moving` is the node whose place it is, if it is one's.
    def contrast(row: TopicRow) -> tuple[bool, bool, int]:
        states = {cell.access for cell in row.seen_by()}
        return states == {TopicAccess.ALL, TopicAccess.COARSE}, place.has_place(row.type), len(states)

    for row in sorted(matrix.rows, key=contrast, reverse=True):
        found = visibility.comparison(context, row)
        if found is not None:
            one = len(row.publishers) == 1 and place.has_place(row.type)
            moving = row.publishers[0] if one else ""
            return {"comparison": found._replace(looks=found.looks[:LOOKS]), "moving": moving}
    return {"comparison": None, "moving": ""}


TODAY_PAGES: Final = (Page("/", ("GET",), show_today),)

HAPPENED_THINGS: Final = 50
MAX_REFUSED: Final = 20  # sentences about denials on one page
_HAPPENED_ENTRIES: Final = 100  # asked at once
_ROUNDS: Final = 10  # of asking, where few entries are of the node that is looked for


async def log(request: Request, context: ConsoleContext) -> Response:
    before = visibility.position(request.query_params.get("before"))
    text = request.query_params.get("node", "")
    node = visibility.name_of(text[1:]) if text else ""
    home = await visibility.load(context, names_of(request))
    questions = (await visibility.questions(context))[0]
    known = KnownIds.of(home.held, home.nodes, questions, home.ending)
    events, following = await _events(context, before, node, known)
    times = [event.at for event in events] or [0]
    first, end = min(times) if following else 0, max(times) if before else math.inf
    denied = [each for each in await visibility.denials(context) if first <= each.at < end]
    told = [each for each in story(events, denied, known) if not node or each.node == node]
    # At most so many denials, the newest, and how many are left out: nodes cause them at will.
    refused = set([each for each in told if each.number < 0][MAX_REFUSED:])
    told = [each for each in told if each not in refused]
    fresh, seen = 0, request.state.session.seen
    if not before:
        fresh = 0 if seen is None else sum(each.number > seen for each in told)
        if events:
            request.state.session.seen = max(seen or 0, *(event.number for event in events))
    more = urlencode({"before": following, **({"node": node} if node else {})})
    return render(
        context,
        request,
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


async def _events(
    context: ConsoleContext, before: int, node: str, known: KnownIds
) -> tuple[list[EventView], int]:
    found: list[EventView] = []
    following = before
    for _ in range(_ROUNDS):
        part = await context.service.events(following, _HAPPENED_ENTRIES)
        for event in part:
            found.append(event)
            following = event.number
            told = story(found, (), known)
            if len([each for each in told if not node or each.node == node]) >= HAPPENED_THINGS:
                return found, following
        if len(part) < _HAPPENED_ENTRIES:
            return found, 0
    return found, following


async def way(request: Request, context: ConsoleContext) -> Response:
    home = await visibility.load(context, names_of(request))
    row = visibility.position(request.query_params.get("row"))
    denied = await visibility.denials(context)
    busy = home.matrix.busiest_first()
    part = busy.window(slice(row, row + flow.MAX_ROWS), slice(flow.MAX_ROWS))
    told = refusals(denied)
    running = {fact.name for fact in home.facts if fact.kind == "publisher"}
    return visibility.render_home(
        context,
        request,
        home,
        "way.html",
        row=row,
        rows=len(busy.rows),
        page_rows=flow.MAX_ROWS,
        shown=busy.rows[row : row + flow.MAX_ROWS],
        flow=flow.draw(part, visibility.refused_names(denied), names_of(request).title),
        running=running,
        refused=sorted(told, key=lambda each: -each.at)[:MAX_REFUSED],
        more_refused=max(0, len(told) - MAX_REFUSED),
    )


HAPPENED_PAGES: Final = (Page("/log", ("GET",), log), Page("/way", ("GET",), way))


async def stream(request: Request, context: ConsoleContext) -> Response:
    session = request.state.session
    is_valid = lambda: context.sessions.is_valid(session, context.elapsed())  # noqa: E731 - one expression
    return StreamingResponse(context.news.open(is_valid), media_type="text/event-stream")


NEWS_PAGES: Final = (Page("/news", ("GET",), stream),)

"""What happened: the record's log and the denials as one time line; and the data flow, live."""

from typing import Final
from urllib.parse import urlencode

from starlette.requests import Request
from starlette.responses import Response

from rossec.authority.console.views import DenialView, EventView
from rossec.console import overview
from rossec.console.context import ConsoleContext
from rossec.console.pictures import flow
from rossec.console.rendering import names_of, render
from rossec.console.routing import Page
from rossec.console.sentences import Known, Sentence, refusals, story

THINGS: Final = 50
MAX_REFUSED: Final = 20  # sentences about denials on one page
_ENTRIES: Final = 100  # asked at once
_ROUNDS: Final = 10  # of asking, where few entries are of the node that is looked for


async def log(request: Request, context: ConsoleContext) -> Response:
    """The time line before an entry, of one node or of all."""
    before = overview.position(request.query_params.get("before"))
    text = request.query_params.get("node", "")
    node = overview.name_of(text[1:]) if text else ""
    home = await overview.load(context, names_of(request))
    questions = (await overview.questions(context))[0]
    known = Known.of(home.held, home.nodes, questions, home.ending)
    events, following = await _events(context, before, node, known)
    denied = _between(await overview.denials(context), events, before, following)
    told, refused = _bounded(
        [each for each in story(events, denied, known) if not node or each.node == node]
    )
    fresh = 0 if before else _look(request, events, told)
    more = urlencode({"before": following, **({"node": node} if node else {})})
    return render(
        context, request, "log.html", live=not before, sentences=told, node=node, before=before,
        more=f"/log?{more}" if following else "", new=fresh, more_refused=refused,
        without_master=home.without_master, again=0 if before else overview.again(home),
    )  # fmt: skip


def _bounded(told: list[Sentence]) -> tuple[list[Sentence], int]:
    """At most so many denials, the newest, and how many are left out: nodes cause them at will."""
    denied = [each for each in told if each.number < 0]
    left = set(denied[MAX_REFUSED:])
    return [each for each in told if each not in left], len(left)


async def _events(
    context: ConsoleContext, before: int, node: str, known: Known
) -> tuple[list[EventView], int]:
    """Entries with about `THINGS` sentences, and the number before which there are more, or 0."""
    found: list[EventView] = []
    following = before
    for _ in range(_ROUNDS):
        part = await context.service.events(following, _ENTRIES)
        for event in part:
            found.append(event)
            following = event.number
            told = story(found, (), known)
            if len([each for each in told if not node or each.node == node]) >= THINGS:
                return found, following
        if len(part) < _ENTRIES:
            return found, 0
    return found, following


def _between(
    denied: tuple[DenialView, ...], events: list[EventView], before: int, following: int
) -> list[DenialView]:
    """The denials of the time of this part: none is shown twice, none left out."""
    first = min((event.at for event in events), default=0) if following else 0
    last = max((event.at for event in events), default=0) if before else None
    return [each for each in denied if each.at >= first and (last is None or each.at < last)]


def _look(request: Request, events: list[EventView], told: list[Sentence]) -> int:
    """How many things are new to this session, which has seen them now."""
    session = request.state.session
    seen = session.seen
    if events:
        session.seen = max(seen or 0, *(event.number for event in events))
    return 0 if seen is None else sum(each.number > seen for each in told)


async def way(request: Request, context: ConsoleContext) -> Response:
    """Who sends what to whom, and what was refused, as a picture and as a list."""
    home = await overview.load(context, names_of(request))
    row = overview.position(request.query_params.get("row"))
    denied = await overview.denials(context)
    busy = home.matrix.busiest_first()
    part = busy.window(slice(row, row + flow.MAX_ROWS), slice(flow.MAX_ROWS))
    told = refusals(denied)
    running = {fact.name for fact in home.facts if fact.kind == "publisher"}
    return render(
        context, request, "way.html", live=True, row=row, rows=len(busy.rows),
        page_rows=flow.MAX_ROWS, shown=busy.rows[row : row + flow.MAX_ROWS],
        flow=flow.draw(part, overview.refused_names(denied), names_of(request).title),
        running=running, again=overview.again(home),
        refused=sorted(told, key=lambda each: -each.at)[:MAX_REFUSED],
        more_refused=max(0, len(told) - MAX_REFUSED), without_master=home.without_master,
    )  # fmt: skip


PAGES: Final = (Page("/log", ("GET",), log), Page("/way", ("GET",), way))

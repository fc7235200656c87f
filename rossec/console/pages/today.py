"""Today: what waits for an answer, who sees what, what it looks like, and what happened."""

from collections.abc import Iterable
from contextlib import suppress
from typing import Any, Final, NamedTuple

from starlette.requests import Request
from starlette.responses import Response

from ca.errors import HintedError
from grants.model import Permission, Right
from rossec.authority.console.views import GrantQuestion
from rossec.console import asking, overview
from rossec.console.context import ConsoleContext
from rossec.console.forms import to_base64url
from rossec.console.matrix import Access, Matrix, TopicRow
from rossec.console.overview import Overview
from rossec.console.pictures import flow, place
from rossec.console.rendering import names_of, render
from rossec.console.routing import Page
from rossec.console.sentences import Known, Part, permissions, story

ROWS: Final = 8
RECEIVERS: Final = 4
LOOKS: Final = 2
THINGS: Final = 9
_ENTRIES: Final = 60  # of the log, of which some have no sentence of their own
_IN_PART: Final = "Some of the policy is not in force"


class Waiting(NamedTuple):
    """A question that waits: a sentence, its page, and since when."""

    parts: tuple[Part, ...]
    path: str
    at: int
    why: str = ""  # the node's own words
    acts: bool = False  # it would do something, not only see it


class Counts(NamedTuple):
    """How many send how many topics, and how many see some of them."""

    senders: int
    topics: int
    receivers: int


async def show(request: Request, context: ConsoleContext) -> Response:
    """The first page."""
    home = await overview.load(context, names_of(request))
    questions, without_policy = await overview.questions(context)
    denied = await overview.denials(context)
    events = await context.service.events(0, _ENTRIES)
    known = Known.of(home.held, home.nodes, questions, home.ending)
    told = [each for each in story(events, denied, known) if each.tone != "note"]
    busy = home.matrix.busiest_first()
    part = busy.window(slice(ROWS), slice(RECEIVERS))
    return render(
        context, request, "today.html", live=True,
        authority=await context.service.status(), waiting=await _waiting(context, questions),
        counts=counts(home.matrix), matrix=part, rows=len(busy.rows),
        receivers=len(busy.receivers), silent=silent(home), **_looks(context, busy),
        flow=flow.draw(part, overview.refused_names(denied), names_of(request).title),
        sentences=told[:THINGS], ending=len(home.ending), again=overview.again(home),
        new=_new(request, [each.number for each in told]), without_master=home.without_master,
        without_policy=without_policy,
    )  # fmt: skip


async def _waiting(context: ConsoleContext, questions: Iterable[GrantQuestion]) -> list[Waiting]:
    """Requests for grants and identities, new phones, and a changed policy, the oldest first."""
    found = [
        Waiting(
            _asked(each),
            f"/ask/{to_base64url(each.id)}",
            each.at,
            each.why,
            asking.acts(each.rights),
        )
        for each in questions
    ]
    found += [
        Waiting(
            (Part(each.name, is_name=True), Part("asks to join")),
            f"/join/{to_base64url(each.id)}",
            each.arrived,
        )
        for each in await context.service.identity_requests()
        if each.state == "pending"
    ]
    found += [
        Waiting((Part(each.name), Part("wants to approve, too")), "/phones", context.clock())
        for each in await context.service.proposals()
    ]
    with suppress(HintedError):  # a policy that cannot be read is told on its own page
        policy = await context.service.policy()
        if policy.mistakes or policy.gives or policy.takes or policy.refused:
            said = "The policy has changed" if policy.gives or policy.takes else _IN_PART
            said = "The policy has mistakes" if policy.mistakes else said
            found.append(Waiting((Part(said),), "/policy", context.clock()))
    return sorted(found, key=lambda each: each.at)


def _asked(question: GrantQuestion) -> tuple[Part, ...]:
    rights = [Permission(each.pattern, Right(each.right)) for each in question.rights]
    drives = any(asking.drives(each) for each in question.rights)
    asks = Part("asks to drive, to" if drives else "asks to")
    return Part(question.node, is_name=True), asks, *permissions(rights)


def counts(matrix: Matrix) -> Counts:
    """The numbers of the first sentence."""
    sent = [row for row in matrix.rows if row.publishers]
    senders = {name for row in sent for name in row.publishers}
    looking = {cell.receiver for row in matrix.rows for cell in row.seen_by()}
    return Counts(len(senders), len(sent), len(looking))


def silent(home: Overview) -> int:
    """How many nodes have a name and see nothing."""
    looking = {cell.receiver for row in home.matrix.rows for cell in row.seen_by()}
    return len({node.name for node in home.nodes if not node.revoked_at} - looking)


def _looks(context: ConsoleContext, matrix: Matrix) -> dict[str, Any]:
    """The topic that shows best that it depends who looks: seen in two ways, a place before all.

    `moving` is the node whose place it is, if it is one's.
    """
    for row in sorted(matrix.rows, key=_contrast, reverse=True):
        found = overview.comparison(context, row)
        if found is not None:
            one = len(row.publishers) == 1 and place.has_place(row.type)
            moving = row.publishers[0] if one else ""
            return {"comparison": found._replace(looks=found.looks[:LOOKS]), "moving": moving}
    return {"comparison": None, "moving": ""}


def _contrast(row: TopicRow) -> tuple[bool, bool, int]:
    states = {cell.access for cell in row.seen_by()}
    return states == {Access.ALL, Access.COARSE}, place.has_place(row.type), len(states)


def _new(request: Request, numbers: list[int]) -> int:
    """How many things happened since this session looked at the log."""
    seen = request.state.session.seen
    return 0 if seen is None else sum(number > seen for number in numbers)


PAGES: Final = (Page("/", ("GET",), show),)

"""A node's request for grants: who, what, why, what it would look like, and for how long."""

from typing import Final

from starlette.requests import Request
from starlette.responses import RedirectResponse, Response

from ca.errors import HintedError
from rossec.authority.console.views import FactView, GrantQuestion
from rossec.console import asking
from rossec.console.context import ConsoleContext
from rossec.console.forms import from_base64url, read_form
from rossec.console.rendering import render
from rossec.console.routing import Page

DENIED: Final = "denied at the console"
_MOST: Final = 8  # filters that are tried out on one page


async def show(request: Request, context: ConsoleContext) -> Response:
    """The question, or that it is answered."""
    number = from_base64url(request.path_params["id"])
    questions = await context.service.questions()
    found = next((each for each in questions if each.id == number), None)
    if found is None:
        return await _answered(request, context, number)
    coarse = found.coarse[-_MOST:]  # the last are rossec's own, and hide most
    ways = [("", found.rights)]
    for name in coarse:
        try:
            ways.append((name, await context.service.consider(number, name, 0)))
        except HintedError:  # this filter does not fit these messages
            continue
    sentence = asking.sentence(found, await _graph(context))
    return render(
        context, request, "ask.html", live=True, found=found, sentence=sentence,
        ways=asking.ways(ways), acts=asking.acts(found.rights),
        alone=asking.why_no_coarser(found), others=_others(questions, found),
        labels=asking.LABELS, looks=asking.looks(found.node, ways, context.preview),
        durations=asking.durations(found, context.clock()),
    )  # fmt: skip


def _others(questions: tuple[GrantQuestion, ...], found: GrantQuestion) -> int:
    """How many more things the node asked for in the same request."""
    same = [each for each in questions if each.request == found.request]
    return len(same) - 1


async def _answered(request: Request, context: ConsoleContext, number: bytes) -> Response:
    """How it was answered, by the record; a service that does not say leaves it open."""
    try:
        answers = await context.service.question_answers(number)
    except HintedError:
        answers = ()
    told = [(each, asking.answer(each)) for each in answers]
    return render(context, request, "asked.html", told=told)


async def deny(request: Request, context: ConsoleContext) -> Response:
    """Deny it: needs no passkey."""
    await read_form(request)
    number = request.path_params["id"]
    await context.service.deny_question(from_base64url(number), DENIED)
    return RedirectResponse(f"/ask/{number}", 303)


async def _graph(context: ConsoleContext) -> tuple[FactView, ...]:
    """The graph; empty while the master is out of reach."""
    try:
        return await context.service.graph()
    except HintedError:
        return ()


PAGES: Final = (
    Page("/ask/{id}", ("GET",), show),
    Page("/ask/{id}/deny", ("POST",), deny),
)

"""A node's request for grants: who, what, why, what it would look like, and for how long."""

from typing import Final

from starlette.requests import Request
from starlette.responses import RedirectResponse, Response

from ca.errors import HintedError
from rossec.authority.console.views import FactView
from rossec.console import asking
from rossec.console.context import ConsoleContext
from rossec.console.forms import from_base64url, read_form
from rossec.console.rendering import render
from rossec.console.routing import Page

DENIED: Final = "denied at the console"
_MOST: Final = 4  # filters that are tried out on one page


async def show(request: Request, context: ConsoleContext) -> Response:
    """The question, or that it is answered."""
    number = from_base64url(request.path_params["id"])
    questions = await context.service.questions()
    found = next((each for each in questions if each.id == number), None)
    if found is None:
        return render(context, request, "asked.html")
    coarse = found.coarse[:_MOST]
    ways = [("", found.rights)]
    for name in coarse:
        try:
            ways.append((name, await context.service.consider(number, name, 0)))
        except HintedError:  # this filter does not fit these messages
            continue
    sentence = asking.sentence(found, await _graph(context))
    return render(
        context, request, "ask.html", live=True, found=found, sentence=sentence,
        ways=[asking.way(name, rights) for name, rights in ways],
        looks=asking.looks(found.node, ways, context.preview),
        durations=asking.durations(found, context.clock()),
    )  # fmt: skip


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

"""Join codes: made with a passkey, shown once to the session that made them, ended without one.

Whoever has the code can join, so it is on one page, once. What is listed later is who joined by it.
"""

from typing import Final

from starlette.requests import Request
from starlette.responses import RedirectResponse, Response

from ca.enrollment import qr
from rossec.console.approving import MAX_USES
from rossec.console.context import ConsoleContext
from rossec.console.forms import from_base64url, read_form
from rossec.console.rendering import render
from rossec.console.routing import Page

ENDED: Final = "ended at the console"


async def show(request: Request, context: ConsoleContext) -> Response:
    """The form for a new one, and those that there are."""
    found = await context.service.invitations()
    now = context.clock()
    return render(
        context, request, "invite.html", most=MAX_USES,
        open=[each for each in found if each.state == "open" and each.expires >= now],
        over=[each for each in found if each.state != "open" or each.expires < now][-20:],
    )  # fmt: skip


async def show_made(request: Request, context: ConsoleContext) -> Response:
    """The code that was made: once, and only where it was approved.

    Raises:
        HintedError: there is no such approval.
    """
    number = from_base64url(request.path_params["id"])
    outcome = await context.service.outcome(number)
    session = request.state.session.id
    is_done = outcome.state == "done" and bool(outcome.data)
    text = outcome.data.decode() if is_done and context.made_codes.take(number, session) else ""
    return render(
        context, request, "invited.html", live=outcome.state == "waiting", outcome=outcome,
        text=text, picture=qr.inline_svg(text) if text else "",
    )  # fmt: skip


async def end(request: Request, context: ConsoleContext) -> Response:
    """End a join code: needs no passkey."""
    await read_form(request)
    await context.service.end_invitation(from_base64url(request.path_params["id"]), ENDED)
    return RedirectResponse("/invite", 303)


PAGES: Final = (
    Page("/invite", ("GET",), show),
    Page("/invite/{id}/end", ("POST",), end),
    Page("/invited/{id}", ("GET",), show_made),
)

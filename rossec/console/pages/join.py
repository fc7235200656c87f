"""A request for an identity that waits in the record: of a node that came with a join code, or that
`rossec ca enroll --later` recorded. Its page is the card of `/add`, and the same approval.
"""

from typing import Final

from starlette.requests import Request
from starlette.responses import RedirectResponse, Response

from rossec.console.approving import IDENTITY_LIFETIME
from rossec.console.context import ConsoleContext
from rossec.console.forms import from_base64url, read_form
from rossec.console.rendering import render
from rossec.console.routing import Page

REJECTED: Final = "rejected at the console"


async def show(request: Request, context: ConsoleContext) -> Response:
    """The card; a request that is answered says so."""
    number = from_base64url(request.path_params["id"])
    waiting = await context.service.identity_requests()
    found = next((each for each in waiting if each.id == number), None)
    return render(
        context, request, "join.html", live=True, found=found, lifetime=IDENTITY_LIFETIME
    )  # fmt: skip


async def reject(request: Request, context: ConsoleContext) -> Response:
    """Deny it: needs no passkey."""
    await read_form(request)
    number = request.path_params["id"]
    await context.service.deny_request(from_base64url(number), REJECTED)
    return RedirectResponse(f"/join/{number}", 303)


PAGES: Final = (
    Page("/join/{id}", ("GET",), show),
    Page("/join/{id}/reject", ("POST",), reject),
)

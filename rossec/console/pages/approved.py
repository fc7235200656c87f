"""What came of an approval: done, waiting for the key or the master, or why not."""

from typing import Final

from starlette.requests import Request
from starlette.responses import Response

from ca.approvals.statement import Kind
from rossec.console.context import ConsoleContext
from rossec.console.forms import from_base64url
from rossec.console.rendering import render
from rossec.console.routing import Page

_RECENT: Final = 200


async def show(request: Request, context: ConsoleContext) -> Response:
    """One approval, until it is done.

    Raises:
        HintedError: there is none with this id.
    """
    number = from_base64url(request.path_params["id"])
    outcome = await context.service.outcome(number)
    approvals = await context.service.approvals(_RECENT)
    approval = next((each for each in approvals if each.id == number), None)
    # Of what was made, a bundle for another host is carried there; a join code is for `/invited`.
    is_carried = approval is not None and approval.kind == Kind.INTERMEDIATE
    is_waiting = outcome.state == "waiting"
    locked = is_waiting and (await context.service.status()).locked
    return render(
        context, request, "approved.html", live=is_waiting, outcome=outcome, locked=locked,
        approval=approval, carried=outcome.data.decode(errors="replace") if is_carried else "",
    )  # fmt: skip


PAGES: Final = (Page("/approved/{id}", ("GET",), show),)

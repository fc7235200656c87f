"""What came of an approval: done, waiting for the key, or why not."""

from typing import Final

from starlette.requests import Request
from starlette.responses import Response

from rossec.authority.console.messages import PREPARED
from rossec.console.context import ConsoleContext
from rossec.console.forms import from_base64url
from rossec.console.rendering import render
from rossec.console.routing import Page

KINDS: Final = tuple(PREPARED)
"""By the number of the statement's kind, less one."""
_RECENT: Final = 200
_CARRIED: Final = ("intermediate",)  # kinds whose result a person carries to its host
_SECRET: Final = ("invitation",)  # kinds whose result only `/invited` shows, once


async def show(request: Request, context: ConsoleContext) -> Response:
    """One approval, until it is done.

    Raises:
        HintedError: there is none with this id.
    """
    number = from_base64url(request.path_params["id"])
    outcome = await context.service.outcome(number)
    approvals = await context.service.approvals(_RECENT)
    approval = next((each for each in approvals if each.id == number), None)
    kind = "" if approval is None else _kind(approval.kind)
    return render(
        context, request, "approved.html", live=outcome.state == "waiting", outcome=outcome,
        approval=approval, kind=kind,
        carried=outcome.data.decode(errors="replace") if kind in _CARRIED else "",
    )  # fmt: skip


def _kind(number: int) -> str:
    return KINDS[number - 1] if 0 < number <= len(KINDS) else ""


PAGES: Final = (Page("/approved/{id}", ("GET",), show),)

"""Phones: the passkeys that approve. A second one comes by a link, and the first approves it.

The link opens `/propose` on the new phone, which makes a passkey and shows digits; here the same
digits are shown, and approving them is an approval like every other. Removing one takes something
away, so it needs no passkey.
"""

from typing import Final

from starlette.requests import Request
from starlette.responses import JSONResponse, RedirectResponse, Response

from ca.enrollment import qr
from ca.enrollment.transcript import group_digits
from rossec.console.context import ConsoleContext
from rossec.console.forms import from_base64url, read_form, read_json
from rossec.console.pages.login import check_pause, counted, read_registration
from rossec.console.rendering import render
from rossec.console.routing import PUBLIC, Page
from rossec.console.sessions import owner_of

REMOVED: Final = "removed at the console"


async def show(request: Request, context: ConsoleContext) -> Response:
    """The phones, and those that want to become one."""
    phones, proposals = await context.service.phones(), await context.service.proposals()
    current = [phone for phone in phones if not phone.ended]
    return render(
        context, request, "phones.html", live=True, phones=current, proposals=proposals,
        ended=[phone for phone in phones if phone.ended],
    )  # fmt: skip


async def link(request: Request, context: ConsoleContext) -> Response:
    """A link for a second phone, as a code to scan."""
    await read_form(request)
    code = await context.service.phone_link(owner_of(request.state.session))
    address = f"{context.settings.origin}/propose#{code}"
    return render(context, request, "phone_link.html", address=address, code=qr.inline_svg(address))


async def remove(request: Request, context: ConsoleContext) -> Response:
    """Remove a phone; its sessions end."""
    await read_form(request)
    phone = from_base64url(request.path_params["id"])
    names = [each.name for each in await context.service.phones() if each.id == phone]
    await context.service.remove_phone(phone, REMOVED)
    own = request.state.session.phone in names
    for name in names:
        context.sessions.end_of_phone(name)
    return RedirectResponse("/login" if own else "/phones", 303)


async def differ(request: Request, context: ConsoleContext) -> Response:
    """The digits differ: the phone that waits is not added. Needs no passkey."""
    await read_form(request)
    await context.service.end_proposal(from_base64url(request.path_params["id"]))
    return RedirectResponse("/phones", 303)


async def ask(request: Request, context: ConsoleContext) -> Response:
    """What the new phone shows first."""
    return render(context, request, "propose.html")


async def propose(request: Request, context: ConsoleContext) -> Response:
    """The new phone's passkey; answers with the page that shows its digits."""
    check_pause(request, context)
    proposing = context.service.propose_passkey(read_registration(await read_json(request)))
    proposal = await counted(request, context, proposing)
    return JSONResponse({"digits": group_digits(proposal.digits)})


PAGES: Final = (
    Page("/phones", ("GET",), show),
    Page("/phones/link", ("POST",), link),
    Page("/phones/{id}/remove", ("POST",), remove),
    Page("/phones/{id}/differ", ("POST",), differ),
    Page("/propose", ("GET",), ask, PUBLIC),
    Page("/propose", ("POST",), propose, PUBLIC),
)

"""Adding a node: its code by camera, picture or text; join codes; and requests that wait in the record.

The page of an enrollment shows the stage it is in and nothing else decides what comes next: the node says
that it is enrolled, and only then this page does. A join code is on one page, once, for the session that made
it: whoever has it can join. A request that waits is of a node that came with one, or that `rossec ca enroll
--later` recorded.
"""

from typing import Final

from starlette.requests import Request
from starlette.responses import JSONResponse, RedirectResponse, Response

from ca.enrollment import qr
from ca.enrollment.sides import group_digits
from ca.errors import CodeRefused, ConflictingOffer, HintedError
from rossec.console.approvals import IDENTITY_LIFETIME, MAX_USES
from rossec.console.context import ConsoleContext
from rossec.console.enrollments import RecordedName, Stage
from rossec.console.rendering import MAX_FRAME, Page, from_base64url, read_form, render, text_field
from rossec.console.sessions import owner_of
from rossec.errors import HttpRefused, ScannerBusy

MAX_ADDRESS: Final = 300
_PICTURES: Final = frozenset({"image/jpeg", "image/png"})


async def show_add(request: Request, context: ConsoleContext) -> Response:
    return _ask(request, context)


async def begin(request: Request, context: ConsoleContext) -> Response:
    form = await read_form(request)
    code = text_field(form, "code", qr.MAX_TEXT).strip()
    address = text_field(form, "address", MAX_ADDRESS).strip()
    try:
        number = context.enrollments.begin(code, address, owner_of(request.state.session))
    except HintedError as error:
        return _ask(request, context, code, address, error)
    return RedirectResponse(f"/add/{number}", 303)


async def read_frame(request: Request, context: ConsoleContext) -> Response:
    """Read the code in a frame of a camera; answers with its text, or that there is none."""
    if request.headers.get("content-type") not in _PICTURES:
        raise HttpRefused("this is not a picture", "send a JPEG", status=415)
    if context.scanner is None:
        hint = "paste the text below the code"
        raise HttpRefused("this console reads no pictures", hint, status=503)
    try:
        return JSONResponse({"text": await context.scanner.read(await request.body()) or ""})
    except ScannerBusy:
        return JSONResponse({"text": ""}, 429)


async def show_one(request: Request, context: ConsoleContext) -> Response:
    number = request.path_params["id"]
    found = context.enrollments.get(number)
    found.check_time()
    name = found.core.request.name if found.core.csr else ""
    held = await context.service.grants() if found.stage is Stage.ENROLLED else ()
    return render(
        context,
        request,
        "adding.html",
        live=not found.is_over,
        enrollment=number,
        found=found,
        stage=found.stage.value,
        name=name,
        digits=group_digits(found.core.digits),
        lifetime=IDENTITY_LIFETIME,
        is_conflict=isinstance(found.error, ConflictingOffer),
        keeps_identity=found.known is RecordedName.SAME_KEY,
        has_grants=any(each.node == name and not each.revoked_at for each in held),
    )


async def reject_node(request: Request, context: ConsoleContext) -> Response:
    await read_form(request)
    number = request.path_params["id"]
    await context.enrollments.reject(number)
    return RedirectResponse(f"/add/{number}", 303)


async def differ(request: Request, context: ConsoleContext) -> Response:
    await read_form(request)
    number = request.path_params["id"]
    await context.enrollments.differ(number)
    return RedirectResponse(f"/add/{number}", 303)


def _ask(
    request: Request,
    context: ConsoleContext,
    code: str = "",
    address: str = "",
    error: HintedError | None = None,
) -> Response:
    return render(
        context,
        request,
        "add.html",
        422 if error else 200,
        code=code,
        address=address,
        problem=error,
        is_label=bool(address) or (bool(error) and _is_label(code)),
    )


def _is_label(text: str) -> bool:
    try:
        return not qr.parse(text).address
    except CodeRefused:
        return False


ADD_PAGES: Final = (
    Page("/add", ("GET",), show_add),
    Page("/add", ("POST",), begin),
    Page("/add/frame", ("POST",), read_frame, max_body=MAX_FRAME),
    Page("/add/{id}", ("GET",), show_one),
    Page("/add/{id}/reject", ("POST",), reject_node),
    Page("/add/{id}/differ", ("POST",), differ),
)

ENDED: Final = "ended at the console"


async def show_invite(request: Request, context: ConsoleContext) -> Response:
    found = await context.service.invitations()
    now = context.clock()
    return render(
        context,
        request,
        "invite.html",
        most=MAX_USES,
        open=[each for each in found if each.state == "open" and each.expires >= now],
        over=[each for each in found if each.state != "open" or each.expires < now][-20:],
    )


async def show_made(request: Request, context: ConsoleContext) -> Response:
    number = from_base64url(request.path_params["id"])
    outcome = await context.service.outcome(number)
    session = request.state.session.id
    is_done = outcome.state == "done" and bool(outcome.data)
    text = outcome.data.decode() if is_done and context.made_codes.take(number, session) else ""
    return render(
        context,
        request,
        "invited.html",
        live=outcome.state == "waiting",
        outcome=outcome,
        text=text,
        picture=qr.inline_svg(text) if text else "",
    )


async def end(request: Request, context: ConsoleContext) -> Response:
    await read_form(request)
    await context.service.end_invitation(from_base64url(request.path_params["id"]), ENDED)
    return RedirectResponse("/invite", 303)


INVITE_PAGES: Final = (
    Page("/invite", ("GET",), show_invite),
    Page("/invite/{id}/end", ("POST",), end),
    Page("/invited/{id}", ("GET",), show_made),
)

REJECTED: Final = "rejected at the console"


async def show_join(request: Request, context: ConsoleContext) -> Response:
    number = from_base64url(request.path_params["id"])
    waiting = await context.service.identity_requests()
    found = next((each for each in waiting if each.id == number), None)
    return render(context, request, "join.html", live=True, found=found, lifetime=IDENTITY_LIFETIME)


async def reject_request(request: Request, context: ConsoleContext) -> Response:
    await read_form(request)
    number = request.path_params["id"]
    await context.service.deny_request(from_base64url(number), REJECTED)
    return RedirectResponse(f"/join/{number}", 303)


JOIN_PAGES: Final = (
    Page("/join/{id}", ("GET",), show_join),
    Page("/join/{id}/reject", ("POST",), reject_request),
)

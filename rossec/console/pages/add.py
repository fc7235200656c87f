"""Adding a node: its code by camera, picture or text; the card; six digits; and how it ended.

The page of an enrollment shows the stage it is in and nothing else decides what comes next: the
node says that it is enrolled, and only then this page does.
"""

from typing import Final

from starlette.requests import Request
from starlette.responses import JSONResponse, RedirectResponse, Response

from ca.enrollment import qr
from ca.enrollment.transcript import group_digits
from ca.errors import CodeRefused, ConflictingOffer, HintedError
from rossec.console.approving import IDENTITY_LIFETIME
from rossec.console.context import ConsoleContext
from rossec.console.enrollment import Known, Stage
from rossec.console.forms import read_form, text_field
from rossec.console.rendering import render
from rossec.console.routing import MAX_FRAME, Page
from rossec.console.sessions import owner_of
from rossec.errors import HttpRefused, ScannerBusy

MAX_ADDRESS: Final = 300
_PICTURES: Final = frozenset({"image/jpeg", "image/png"})


async def show(request: Request, context: ConsoleContext) -> Response:
    """The page that takes a code."""
    return _ask(request, context)


async def begin(request: Request, context: ConsoleContext) -> Response:
    """Begin with the text of a code; what is wrong with it is said on the same page."""
    form = await read_form(request)
    code = text_field(form, "code", qr.MAX_TEXT).strip()
    address = text_field(form, "address", MAX_ADDRESS).strip()
    try:
        number = context.enrollments.begin(code, address, owner_of(request.state.session))
    except HintedError as error:
        return _ask(request, context, code, address, error)
    return RedirectResponse(f"/add/{number}", 303)


async def read_frame(request: Request, context: ConsoleContext) -> Response:
    """Read the code in a frame of a camera; answers with its text, or that there is none.

    Raises:
        HttpRefused: not a picture, or nobody reads them here.
        PictureRefused: it cannot be read.
    """
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
    """An enrollment, by its stage.

    Raises:
        EnrollmentUnknown: there is none.
    """
    number = request.path_params["id"]
    found = context.enrollments.get(number)
    found.check_time()
    name = found.core.request.name if found.core.csr else ""
    held = await context.service.grants() if found.stage is Stage.ENROLLED else ()
    return render(
        context, request, "adding.html", live=not found.is_over, enrollment=number, found=found,
        stage=found.stage.value, name=name, digits=group_digits(found.core.digits),
        lifetime=IDENTITY_LIFETIME, is_conflict=isinstance(found.error, ConflictingOffer),
        keeps_identity=found.known is Known.SAME_KEY,
        has_grants=any(each.node == name and not each.revoked_at for each in held),
    )  # fmt: skip


async def reject(request: Request, context: ConsoleContext) -> Response:
    """Reject a node: needs no passkey."""
    await read_form(request)
    number = request.path_params["id"]
    await context.enrollments.reject(number)
    return RedirectResponse(f"/add/{number}", 303)


async def differ(request: Request, context: ConsoleContext) -> Response:
    """The digits differ: end it here too, and what was signed. Needs no passkey."""
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
        context, request, "add.html", 422 if error else 200, code=code, address=address,
        problem=error, is_label=bool(address) or (bool(error) and _is_label(code)),
    )  # fmt: skip


def _is_label(text: str) -> bool:
    try:
        return not qr.parse(text).address
    except CodeRefused:
        return False


PAGES: Final = (
    Page("/add", ("GET",), show),
    Page("/add", ("POST",), begin),
    Page("/add/frame", ("POST",), read_frame, max_body=MAX_FRAME),
    Page("/add/{id}", ("GET",), show_one),
    Page("/add/{id}/reject", ("POST",), reject),
    Page("/add/{id}/differ", ("POST",), differ),
)

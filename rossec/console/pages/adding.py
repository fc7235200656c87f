"""Adding a node: its code by camera, picture or text; join codes; and requests that wait in the record.

The page of an enrollment shows the stage it is in and nothing else decides what comes next: the node says
that it is enrolled, and only then this page does. A request that waits is of a node that came with a join
code, or that `rossec ca enroll --later` recorded.
"""

from typing import Final

from starlette.responses import JSONResponse, Response

from ca.enrollment import qr
from ca.enrollment.sides import group_digits
from ca.errors import CodeRefused, ConflictingOffer, HintedError
from rossec.console.approvals import IDENTITY_LIFETIME, MAX_USES
from rossec.console.enrollments import REJECTED, RecordedName, Stage
from rossec.console.rendering import MAX_FRAME, PageList, Visit, go, text_field
from rossec.errors import HttpRefused, ScannerBusy

PAGES: Final = PageList()
MAX_ADDRESS: Final = 300
_PICTURES: Final = frozenset({"image/jpeg", "image/png"})


@PAGES.get("/add")
async def show_add(visit: Visit) -> Response:
    return _ask(visit)


@PAGES.post("/add")
async def begin(visit: Visit) -> Response:
    form = await visit.form()
    code = text_field(form, "code", qr.MAX_TEXT).strip()
    address = text_field(form, "address", MAX_ADDRESS).strip()
    try:
        number = visit.context.enrollments.begin(code, address, visit.owner)
    except HintedError as error:
        return _ask(visit, code, address, error)
    return go(f"/add/{number}")


@PAGES.post("/add/frame", max_body=MAX_FRAME)
async def read_frame(visit: Visit) -> Response:
    if visit.request.headers.get("content-type") not in _PICTURES:
        raise HttpRefused("this is not a picture", "send a JPEG", status=415)
    if visit.context.scanner is None:
        hint = "paste the text below the code"
        raise HttpRefused("this console reads no pictures", hint, status=503)
    try:
        return JSONResponse({"text": await visit.context.scanner.read(await visit.request.body()) or ""})
    except ScannerBusy:
        return JSONResponse({"text": ""}, 429)


@PAGES.get("/add/{id}")
async def show_one(visit: Visit) -> Response:
    number = visit.path["id"]
    found = visit.context.enrollments.get(number)
    found.check_time()
    name = found.core.request.name if found.core.csr else ""
    held = await visit.service.grants() if found.stage is Stage.ENROLLED else ()
    return visit.show(
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


@PAGES.post("/add/{id}/reject")
async def reject_node(visit: Visit) -> Response:
    await visit.form()
    await visit.context.enrollments.get(visit.path["id"]).reject()
    return go(f"/add/{visit.path['id']}")


@PAGES.post("/add/{id}/differ")
async def differ(visit: Visit) -> Response:
    await visit.form()
    await visit.context.enrollments.differ(visit.path["id"])
    return go(f"/add/{visit.path['id']}")


def _ask(visit: Visit, code: str = "", address: str = "", error: HintedError | None = None) -> Response:
    try:
        is_label = bool(address) or (error is not None and not qr.parse(code).address)
    except CodeRefused:
        is_label = False
    status = 422 if error else 200
    return visit.show("add.html", status, code=code, address=address, problem=error, is_label=is_label)


ENDED: Final = "ended at the console"


@PAGES.get("/invite")
async def show_invite(visit: Visit) -> Response:
    found = await visit.service.invitations()
    now = visit.context.clock()
    return visit.show(
        "invite.html",
        most=MAX_USES,
        open=[each for each in found if each.state == "open" and each.expires >= now],
        over=[each for each in found if each.state != "open" or each.expires < now][-20:],
    )


@PAGES.get("/invited/{id}")
async def show_made(visit: Visit) -> Response:
    number = visit.id
    outcome = await visit.service.outcome(number)
    session = visit.session.id
    # Once, for the session that made it: whoever has the code can join.
    is_done = outcome.state == "done" and bool(outcome.data)
    text = outcome.data.decode() if is_done and visit.context.made_codes.pop(number, session) else ""
    return visit.show(
        "invited.html",
        live=outcome.state == "waiting",
        outcome=outcome,
        text=text,
        picture=qr.inline_svg(text) if text else "",
    )


@PAGES.post("/invite/{id}/end")
async def end(visit: Visit) -> Response:
    await visit.form()
    await visit.service.end_invitation(visit.id, ENDED)
    return go("/invite")


@PAGES.get("/join/{id}")
async def show_join(visit: Visit) -> Response:
    waiting = await visit.service.identity_requests()
    found = next((each for each in waiting if each.id == visit.id), None)
    return visit.show("join.html", live=True, found=found, lifetime=IDENTITY_LIFETIME)


@PAGES.post("/join/{id}/reject")
async def reject_request(visit: Visit) -> Response:
    await visit.form()
    await visit.service.deny_request(visit.id, REJECTED)
    return go(f"/join/{visit.path['id']}")

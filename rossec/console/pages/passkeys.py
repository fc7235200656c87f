"""Logging in, the phones that approve, and approving itself.

A code is in the fragment of the address it comes with, which browsers send to nobody; the page takes it out
and posts it. It is used once, either to look, or together with the new passkey that it adds: so nobody who
only has a session can add one. A second phone comes by a link and shows digits, and the first approves it;
removing one takes something away, so it needs no passkey. Whether a code or a passkey is right is decided by
the authority's service: a console that lies about what it shows can ask for another signature, but not
without the phone, and the record keeps it.
"""

import secrets
from collections.abc import Awaitable
from typing import Any, Final, NamedTuple, TypeVar

from starlette.requests import Request
from starlette.responses import JSONResponse, RedirectResponse, Response

from ca.approvals.statement import MAX_PAYLOAD, StatementKind
from ca.encoding import decode
from ca.enrollment import qr
from ca.enrollment.sides import group_digits
from ca.errors import EncodingError, HintedError
from grants import document
from grants.errors import GrantError
from grants.model import ID_SIZE
from rossec.authority.console.messages import LoginChallenge, PasskeyAssertion, PasskeyRegistration, Prepared
from rossec.console import approvals, words
from rossec.console.context import ConsoleContext
from rossec.console.options import MAX_PHONE_NAME
from rossec.console.rendering import (
    PUBLIC,
    Page,
    bytes_field,
    from_base64url,
    read_form,
    read_json,
    render,
    text_field,
    to_base64url,
)
from rossec.console.sentences import SentencePart, permission
from rossec.console.sessions import COOKIE, COOKIE_SIZE, owner_of
from rossec.errors import HttpRefused, KeyServiceFailed

_T = TypeVar("_T")
FIRST: Final = "/"  # the page after a login


async def show_login(request: Request, context: ConsoleContext) -> Response:
    return render(context, request, "login.html", problem="")


async def look(request: Request, context: ConsoleContext) -> Response:
    form = await read_form(request)
    try:
        check_pause(request, context)
        code = text_field(form, "code").strip()
        await counted(request, context, context.service.redeem(code))
    except HttpRefused as error:
        return render(context, request, "login.html", error.status, problem=f"{error}: {error.hint}")
    return _begin(RedirectResponse(FIRST, 303), context, "")


async def challenge(request: Request, context: ConsoleContext) -> Response:
    await read_json(request)
    with context.turns.wait(address_of(request)):
        made = await context.service.login_challenge(context.settings.origin)
    return JSONResponse(challenge_fields(made, context.clock()))


async def log_in(request: Request, context: ConsoleContext) -> Response:
    check_pause(request, context)
    fields = await read_json(request)
    asking = context.service.login(bytes_field(fields, "id"), read_assertion(fields))
    phone = await counted(request, context, asking)
    return _begin(JSONResponse({"next": FIRST}), context, phone)


async def new(request: Request, context: ConsoleContext) -> Response:
    await read_json(request)
    settings = context.settings
    with context.turns.wait(address_of(request)):
        made = await context.service.new_passkey(settings.origin, settings.rp_id)
    return JSONResponse(challenge_fields(made, context.clock()))


async def add_phone(request: Request, context: ConsoleContext) -> Response:
    check_pause(request, context)
    adding = context.service.add_passkey(read_registration(await read_json(request)))
    view = await counted(request, context, adding)
    return _begin(JSONResponse({"next": FIRST}), context, view.name)


async def log_out(request: Request, context: ConsoleContext) -> Response:
    context.sessions.end(request.state.session)
    response = RedirectResponse("/login", 303)
    response.delete_cookie(COOKIE, path="/", secure=True, httponly=True, samesite="strict")
    return response


def challenge_fields(made: LoginChallenge | Prepared, now: int) -> dict[str, object]:
    """A challenge as `approve.js` reads it; the timeout is in milliseconds."""
    return {
        "id": to_base64url(made.id),
        "challenge": to_base64url(made.challenge),
        "credentials": [to_base64url(each) for each in made.credentials],
        "rpId": made.rp_id,
        "timeout": max(0, made.until - now) * 1000,
    }


def read_assertion(fields: dict[str, Any]) -> PasskeyAssertion:
    names = ("credential", "clientData", "authenticatorData", "signature")
    return PasskeyAssertion(*(bytes_field(fields, name) for name in names))


def read_registration(fields: dict[str, Any]) -> PasskeyRegistration:
    name = text_field(fields, "name", MAX_PHONE_NAME).strip()
    if not name:
        raise HttpRefused("a phone needs a name", "for example: my phone", status=422)
    code = text_field(fields, "code").strip()
    data = (bytes_field(fields, "clientData"), bytes_field(fields, "attestation"))
    return PasskeyRegistration(bytes_field(fields, "id"), code, name, *data)


def check_pause(request: Request, context: ConsoleContext) -> None:
    """Return if this address was not wrong too often."""
    if context.failures.is_blocked(address_of(request), context.elapsed()):
        raise HttpRefused("too many attempts", "wait a minute", status=429)


async def counted(request: Request, context: ConsoleContext, asking: Awaitable[_T]) -> _T:
    try:
        return await asking
    except KeyServiceFailed:
        raise
    except HintedError as error:
        context.failures.note(address_of(request), context.elapsed())
        raise HttpRefused(str(error), error.hint, status=403) from error


def address_of(request: Request) -> str:
    """The address of whoever asks; empty: not known (a proxy's socket)."""
    return request.client.host if request.client is not None else ""


def _begin(response: Response, context: ConsoleContext, phone: str) -> Response:
    settings, secret = context.settings, secrets.token_bytes(COOKIE_SIZE)
    value = context.sessions.begin(secret, phone, context.elapsed())
    response.set_cookie(
        COOKIE, value, max_age=settings.lifetime, path="/", secure=True, httponly=True, samesite="strict"
    )
    return response


LOGIN_PAGES: Final = (
    Page("/login", ("GET",), show_login, PUBLIC),
    Page("/login", ("POST",), look, PUBLIC, looks=True),
    Page("/login/challenge", ("POST",), challenge, PUBLIC, looks=True),
    Page("/login/passkey", ("POST",), log_in, PUBLIC, looks=True),
    Page("/login/new", ("POST",), new, PUBLIC),
    Page("/login/phone", ("POST",), add_phone, PUBLIC),
    Page("/logout", ("POST",), log_out, looks=True),
)

REMOVED: Final = "removed at the console"


async def show_phones(request: Request, context: ConsoleContext) -> Response:
    phones, proposals = await context.service.phones(), await context.service.proposals()
    current = [phone for phone in phones if not phone.ended]
    return render(
        context,
        request,
        "phones.html",
        live=True,
        phones=current,
        proposals=proposals,
        ended=[phone for phone in phones if phone.ended],
    )


async def link(request: Request, context: ConsoleContext) -> Response:
    await read_form(request)
    code = await context.service.phone_link(owner_of(request.state.session))
    address = f"{context.settings.origin}/propose#{code}"
    return render(context, request, "phone_link.html", address=address, code=qr.inline_svg(address))


async def remove(request: Request, context: ConsoleContext) -> Response:
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
    return render(context, request, "propose.html")


async def propose(request: Request, context: ConsoleContext) -> Response:
    check_pause(request, context)
    proposing = context.service.propose_passkey(read_registration(await read_json(request)))
    proposal = await counted(request, context, proposing)
    return JSONResponse({"digits": group_digits(proposal.digits)})


PHONES_PAGES: Final = (
    Page("/phones", ("GET",), show_phones),
    Page("/phones/link", ("POST",), link),
    Page("/phones/{id}/remove", ("POST",), remove),
    Page("/phones/{id}/differ", ("POST",), differ),
    Page("/propose", ("GET",), ask, PUBLIC),
    Page("/propose", ("POST",), propose, PUBLIC),
)


async def prepare(request: Request, context: ConsoleContext) -> Response:
    act = await approvals.read(context, request.path_params["kind"], await read_form(request))
    owner = owner_of(request.state.session)
    made = await context.service.prepare(act.kind, [*act.arguments], owner)
    if not made.credentials:
        raise HttpRefused(
            "no phone is set up", "get a code at the terminal: rossec console phone", status=409
        )
    context.pending.add(made.id, request.state.session.id, act, owner)
    return JSONResponse(challenge_fields(made, context.clock()))


async def approve(request: Request, context: ConsoleContext) -> Response:
    statement = from_base64url(request.path_params["id"])
    session = request.state.session.id
    act = context.pending.get(statement, session)
    outcome = await context.service.approve(statement, read_assertion(await read_json(request)))
    context.pending.remove(statement)
    return JSONResponse({"next": approvals.carried_out(context, act, outcome, session)})


APPROVE_PAGES: Final = (
    Page("/prepare/{kind}", ("POST",), prepare),
    Page("/approve/{id}", ("POST",), approve),
)

_RECENT: Final = 200


class Given(NamedTuple):
    node: str
    parts: tuple[SentencePart, ...]
    words: str
    until: int


async def show_approved(request: Request, context: ConsoleContext) -> Response:
    number = from_base64url(request.path_params["id"])
    outcome = await context.service.outcome(number)
    approvals = await context.service.approvals(_RECENT)
    approval = next((each for each in approvals if each.id == number), None)
    # Of what was made, a bundle for another host is carried there; a join code is for `/invited`.
    is_carried = approval is not None and approval.kind == StatementKind.INTERMEDIATE
    of_grant = approval is not None and approval.kind == StatementKind.GRANT
    is_waiting = outcome.state == "waiting"
    locked = is_waiting and (await context.service.status()).locked
    return render(
        context,
        request,
        "approved.html",
        live=is_waiting,
        outcome=outcome,
        locked=locked,
        approval=approval,
        given=_given(outcome.data) if of_grant else (),
        carried=outcome.data.decode(errors="replace") if is_carried else "",
    )


def _given(data: bytes) -> list[Given]:
    # What the grants with these claims give; nothing if they cannot be read, or are not made.
    try:
        bodies = decode(data, limit=MAX_PAYLOAD) if data else []
        found = bodies if isinstance(bodies, list) else []
        grants = [document.read_claims(body, bytes(ID_SIZE)) for body in found if isinstance(body, bytes)]
    except (EncodingError, GrantError):
        return []
    return [
        Given(
            grant.subject,
            permission(each)[:2],
            "" if each.restriction is None else words.plain([each.restriction]),
            max(grant.expires, grant.cap),
        )
        for grant in grants
        for each in grant.permissions
    ]


APPROVED_PAGES: Final = (Page("/approved/{id}", ("GET",), show_approved),)

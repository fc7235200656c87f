"""Logging in: with a code from the terminal, or with the passkey of a phone that is set up.

A code is in the fragment of the address it comes with, which browsers send to nobody; the page
takes it out and posts it. It is used once, either to look, or together with the new passkey that it
adds: so nobody who only has a session can add one. Whether a code or a passkey is right is decided
by the authority's service; sessions are this console's.
"""

import secrets
from collections.abc import Awaitable
from typing import Any, Final, TypeVar

from starlette.requests import Request
from starlette.responses import JSONResponse, RedirectResponse, Response

from ca.errors import HintedError
from rossec.authority.console.client import Assertion, Registration
from rossec.authority.console.views import LoginChallenge
from rossec.console.context import ConsoleContext
from rossec.console.forms import bytes_field, read_form, read_json, text_field, to_base64url
from rossec.console.phone_names import MAX_NAME
from rossec.console.rendering import render
from rossec.console.routing import PUBLIC, Page
from rossec.console.sessions import COOKIE, COOKIE_SIZE
from rossec.errors import HttpRefused, KeyServiceFailed

_T = TypeVar("_T")
FIRST: Final = "/"  # the page after a login


async def show(request: Request, context: ConsoleContext) -> Response:
    """The page that asks who is there."""
    return render(context, request, "login.html", problem="")


async def look(request: Request, context: ConsoleContext) -> Response:
    """Log in with a code, to look."""
    form = await read_form(request)
    try:
        check_pause(request, context)
        code = text_field(form, "code").strip()
        await counted(request, context, context.service.redeem(code))
    except HttpRefused as error:
        return render(
            context, request, "login.html", error.status, problem=f"{error}: {error.hint}"
        )
    return _begin(RedirectResponse(FIRST, 303), context, "")


async def challenge(request: Request, context: ConsoleContext) -> Response:
    """What a passkey is to sign for a login."""
    await read_json(request)
    with context.turns.wait(address_of(request)):
        made = await context.service.login_challenge(context.settings.origin)
    return JSONResponse(challenge_fields(made, context.clock()))


async def log_in(request: Request, context: ConsoleContext) -> Response:
    """Log in with a passkey."""
    check_pause(request, context)
    fields = await read_json(request)
    asking = context.service.login(bytes_field(fields, "id"), read_assertion(fields))
    phone = await counted(request, context, asking)
    return _begin(JSONResponse({"next": FIRST}), context, phone)


async def new(request: Request, context: ConsoleContext) -> Response:
    """What a new passkey is to sign."""
    await read_json(request)
    settings = context.settings
    with context.turns.wait(address_of(request)):
        made = await context.service.new_passkey(settings.origin, settings.rp_id)
    return JSONResponse(challenge_fields(made, context.clock()))


async def add_phone(request: Request, context: ConsoleContext) -> Response:
    """Set up a phone: its passkey and the code from the terminal, together."""
    check_pause(request, context)
    adding = context.service.add_passkey(read_registration(await read_json(request)))
    view = await counted(request, context, adding)
    return _begin(JSONResponse({"next": FIRST}), context, view.name)


async def log_out(request: Request, context: ConsoleContext) -> Response:
    """End the session."""
    context.sessions.end(request.state.session)
    response = RedirectResponse("/login", 303)
    response.delete_cookie(COOKIE, path="/", secure=True, httponly=True, samesite="strict")
    return response


def challenge_fields(made: LoginChallenge, now: int) -> dict[str, object]:
    """A challenge as `approve.js` reads it; the timeout is in milliseconds."""
    return {
        "id": to_base64url(made.id),
        "challenge": to_base64url(made.challenge),
        "credentials": [to_base64url(each) for each in made.credentials],
        "rpId": made.rp_id,
        "timeout": max(0, made.until - now) * 1000,
    }


def read_assertion(fields: dict[str, Any]) -> Assertion:
    """What `approve.js` sends of an assertion.

    Raises:
        HttpRefused: a field is missing or malformed.
    """
    names = ("credential", "clientData", "authenticatorData", "signature")
    return Assertion(*(bytes_field(fields, name) for name in names))


def read_registration(fields: dict[str, Any]) -> Registration:
    """What `approve.js` sends of a new passkey.

    Raises:
        HttpRefused: a field is missing or malformed, or the name is empty.
    """
    name = text_field(fields, "name", MAX_NAME).strip()
    if not name:
        raise HttpRefused("a phone needs a name", "for example: my phone", status=422)
    code = text_field(fields, "code").strip()
    data = (bytes_field(fields, "clientData"), bytes_field(fields, "attestation"))
    return Registration(bytes_field(fields, "id"), code, name, *data)


def check_pause(request: Request, context: ConsoleContext) -> None:
    """Return if this address was not wrong too often.

    Raises:
        HttpRefused: it has to wait.
    """
    if context.failures.is_blocked(address_of(request), context.elapsed()):
        raise HttpRefused("too many attempts", "wait a minute", status=429)


async def counted(request: Request, context: ConsoleContext, asking: Awaitable[_T]) -> _T:
    """What `asking` returns; a refusal counts against the address.

    Raises:
        HttpRefused: the service refused.
        KeyServiceFailed: it does not answer, which is nobody's fault here.
    """
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
        COOKIE, value, max_age=settings.lifetime, path="/", secure=True, httponly=True,
        samesite="strict",
    )  # fmt: skip
    return response


PAGES: Final = (
    Page("/login", ("GET",), show, PUBLIC),
    Page("/login", ("POST",), look, PUBLIC, looks=True),
    Page("/login/challenge", ("POST",), challenge, PUBLIC, looks=True),
    Page("/login/passkey", ("POST",), log_in, PUBLIC, looks=True),
    Page("/login/new", ("POST",), new, PUBLIC),
    Page("/login/phone", ("POST",), add_phone, PUBLIC),
    Page("/logout", ("POST",), log_out, looks=True),
)

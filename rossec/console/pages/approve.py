"""Approving: the service makes a statement, a passkey signs its digest, the service verifies that.

The same two requests for every kind (`approve.js` makes them): `/prepare/KIND` with the form's
fields, `/approve/ID` with the assertion. Nothing is decided here: a console that lies about what
it shows can ask for another signature, but not without the phone, and the record keeps it.
"""

from typing import Final

from starlette.requests import Request
from starlette.responses import JSONResponse, Response

from rossec.console import approving
from rossec.console.context import ConsoleContext
from rossec.console.forms import from_base64url, read_form, read_json, to_base64url
from rossec.console.pages.login import read_assertion
from rossec.console.routing import Page
from rossec.console.sessions import owner_of
from rossec.errors import HttpRefused


async def prepare(request: Request, context: ConsoleContext) -> Response:
    """Have a statement made of a form; answers with what the passkey is to sign.

    Raises:
        HttpRefused: no phone can approve.
        HintedError: the form or the service refuses.
    """
    act = await approving.read(context, request.path_params["kind"], await read_form(request))
    owner = owner_of(request.state.session)
    made = await context.service.prepare(act.kind, *act.arguments, owner=owner)
    if not made.credentials:
        raise HttpRefused(
            "no phone is set up", "get a code at the terminal: rossec console phone", status=409
        )
    context.pending.add(made.id, request.state.session.id, act, owner)
    return JSONResponse({
        "id": to_base64url(made.id),
        "challenge": to_base64url(made.challenge),
        "credentials": [to_base64url(each) for each in made.credentials],
        "rpId": made.rp_id,
        "timeout": max(0, made.until - context.clock()) * 1000,
    })  # fmt: skip


async def approve(request: Request, context: ConsoleContext) -> Response:
    """Approve a statement with a passkey's assertion; answers with the next page.

    Raises:
        HintedError: it was not asked here, or the service refuses.
    """
    statement = from_base64url(request.path_params["id"])
    session = request.state.session.id
    act = context.pending.get(statement, session)
    outcome = await context.service.approve(statement, read_assertion(await read_json(request)))
    context.pending.remove(statement)
    return JSONResponse({"next": approving.carried_out(context, act, outcome, session)})


PAGES: Final = (
    Page("/prepare/{kind}", ("POST",), prepare),
    Page("/approve/{id}", ("POST",), approve),
)

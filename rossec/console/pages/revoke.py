"""Ending what was allowed: the reason, and three ticks as they come true. Needs no passkey.

Taking away is never harder than giving: a session is enough, and while the key is locked the
revocation is recorded and signed at unlock. A whole node asks for its name, since it loses all.
"""

from collections.abc import Mapping
from contextlib import suppress
from typing import Final
from urllib.parse import urlencode

from starlette.requests import Request
from starlette.responses import RedirectResponse, Response

from ca.errors import HintedError
from ca.names import is_master_name
from rossec.console import approving
from rossec.console.context import ConsoleContext
from rossec.console.forms import from_base64url, read_form, to_base64url
from rossec.console.matrix import held_grants
from rossec.console.rendering import render
from rossec.console.routing import Page
from rossec.console.sentences import permissions
from rossec.errors import FormRefused, HttpRefused

REFRESH: Final = 2  # seconds until the page looks again
MAX_NUMBER: Final = 1 << 53
_EMPTY: Final[Mapping[str, str]] = {"reason": "", "name": ""}


async def ask_grant(request: Request, context: ConsoleContext) -> Response:
    """Ask for the reason to end one grant.

    Raises:
        HttpRefused: there is no such grant.
    """
    return await _ask_grant(request, context)


async def _ask_grant(
    request: Request, context: ConsoleContext, problem: FormRefused | None = None, given: str = ""
) -> Response:
    node, what = await _grant(context, from_base64url(request.path_params["id"]))
    return render(
        context, request, "revoke.html", 422 if problem else 200, node=node, what=what,
        asks_name=False, is_master=False, problem=problem, reason=given, typed="",
    )  # fmt: skip


async def revoke_grant(request: Request, context: ConsoleContext) -> Response:
    """End it."""
    number = from_base64url(request.path_params["id"])
    form = _exactly(await read_form(request), {"reason"})
    try:
        reason = approving.reason(form)
    except FormRefused as problem:  # said where it was typed, with a field to go on
        return await _ask_grant(request, context, problem, form["reason"])
    epoch, seq = await context.service.revoke_grant(number, reason)
    return _follow(epoch, seq, grant=to_base64url(number))


async def ask_node(request: Request, context: ConsoleContext) -> Response:
    """Ask for the reason to revoke a whole node.

    Raises:
        HttpRefused: there is no such node.
    """
    name = await _node(context, f"/{request.path_params['name']}")
    return _ask_node(request, context, name)


def _ask_node(
    request: Request,
    context: ConsoleContext,
    name: str,
    problem: FormRefused | None = None,
    form: Mapping[str, str] = _EMPTY,
) -> Response:
    return render(
        context, request, "revoke.html", 422 if problem else 200, node=name, what=(),
        asks_name=True, is_master=is_master_name(name), problem=problem,
        reason=form["reason"], typed=form["name"],
    )  # fmt: skip


async def revoke_node(request: Request, context: ConsoleContext) -> Response:
    """Revoke it: every key of it, and with them all it was allowed."""
    name = await _node(context, f"/{request.path_params['name']}")
    form = _exactly(await read_form(request), {"reason", "name"})
    try:
        approving.check_typed(form, name)
        reason = approving.reason(form)
    except FormRefused as problem:
        return _ask_node(request, context, name, problem, form)
    epoch, seq = await context.service.revoke_node(name, reason)
    return _follow(epoch, seq, node=name)


async def show(request: Request, context: ConsoleContext) -> Response:
    """How far a revocation has come; the page looks again until every node has it."""
    epoch, seq = (_number(request.path_params[part]) for part in ("epoch", "seq"))
    node, what = await _subject(request, context)
    standing = await context.service.standing(epoch, seq)
    locked = not standing.is_signed and (await context.service.status()).locked
    has_all = 0 < standing.nodes == standing.nodes_with_list
    answer = render(
        context, request, "revoked.html", standing=standing, node=node, what=what, locked=locked,
        has_all=has_all,
    )  # fmt: skip
    if not has_all:
        answer.headers["Refresh"] = str(REFRESH)
        return answer
    # So that it stays ended where the master, which alone knows, is away in the next moment.
    with suppress(HintedError):
        context.endings.note(await context.service.standing(0, 0), context.clock())
    return answer


async def _subject(request: Request, context: ConsoleContext) -> tuple[str, tuple[object, ...]]:
    """The node that was meant, and what it could do: as the record says, not the address."""
    found = request.query_params
    if "grant" in found:
        return await _grant(context, from_base64url(found["grant"]))
    return (await _node(context, found["node"]), ()) if "node" in found else ("", ())


async def _grant(context: ConsoleContext, number: bytes) -> tuple[str, tuple[object, ...]]:
    views = [each for each in await context.service.grants() if each.id == number]
    nodes, now = await context.service.nodes(), context.clock()
    held = held_grants(nodes, views, now, context.endings.heard)
    if not views:
        raise HttpRefused("there is no such grant", "it has ended long ago", status=404)
    return views[0].node, permissions(held[0].grant.permissions) if held else ()


async def _node(context: ConsoleContext, name: str) -> str:
    if all(each.name != name for each in await context.service.nodes()):
        raise HttpRefused("there is no such node", "see who sees what", status=404)
    return name


def _exactly(form: dict[str, str], fields: set[str]) -> dict[str, str]:
    if form.keys() != fields:
        raise FormRefused("the form has other fields than its page", "load the page anew")
    return form


def _number(text: str) -> int:
    if not (text.isascii() and text.isdigit() and len(text) <= 16):
        raise HttpRefused("there is no such list", "is the address right?", status=404)
    return int(text)


def _follow(epoch: int, seq: int, **subject: str) -> Response:
    return RedirectResponse(f"/revoked/{epoch}/{seq}?{urlencode(subject)}", 303)


PAGES: Final = (
    Page("/revoke/grant/{id}", ("GET",), ask_grant),
    Page("/revoke/grant/{id}", ("POST",), revoke_grant),
    Page("/revoke/node/{name:path}", ("GET",), ask_node),
    Page("/revoke/node/{name:path}", ("POST",), revoke_node),
    Page("/revoked/{epoch}/{seq}", ("GET",), show),
)

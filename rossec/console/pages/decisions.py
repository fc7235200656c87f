"""What is decided: a request for grants, the policy, renewals, other hosts that sign; and what is ended.

Taking away is never harder than giving: a session is enough, and while the key is locked the revocation is
recorded and signed at unlock. A whole node asks for its name, since it loses all. Three ticks say how far an
end has come.
"""

from collections.abc import Mapping
from contextlib import suppress
from typing import Final
from urllib.parse import urlencode

from starlette.requests import Request
from starlette.responses import RedirectResponse, Response

from ca.certificates import check_intermediate_request
from ca.errors import HintedError
from ca.keys.signing import thumbprint
from ca.names import is_master_name
from rossec.authority.console.messages import FactView, PolicyRight, QuestionAnswer
from rossec.console import approvals, words
from rossec.console.approvals import certificate_request
from rossec.console.context import ConsoleContext
from rossec.console.matrix import held_grants
from rossec.console.rendering import (
    MAX_BODY,
    Page,
    from_base64url,
    read_form,
    render,
    text_field,
    to_base64url,
)
from rossec.console.sentences import SentencePart, permissions, wanted
from rossec.errors import FormRefused, HttpRefused

DENIED: Final = "denied at the console"
_MOST: Final = 8  # filters that are tried out on one page


async def show_ask(request: Request, context: ConsoleContext) -> Response:
    number = from_base64url(request.path_params["id"])
    questions = await context.service.questions()
    found = next((each for each in questions if each.id == number), None)
    if found is None:
        return await _answered(request, context, number)
    coarse = found.coarse[-_MOST:]  # the last are rossec's own, and hide most
    ways = [("", found.rights)]
    for name in coarse:
        try:
            ways.append((name, await context.service.consider(number, name, 0)))
        except HintedError:  # this filter does not fit these messages
            continue
    facts: tuple[FactView, ...] = ()
    with suppress(HintedError):
        facts = await context.service.graph()
    return render(
        context,
        request,
        "ask.html",
        live=True,
        found=found,
        sentence=approvals.sentence(found, facts),
        ways=approvals.ways(ways),
        acts=approvals.acts(found.rights),
        alone=approvals.why_no_coarser(found),
        others=sum(each.request == found.request for each in questions) - 1,
        labels=approvals.LABELS,
        looks=approvals.looks(found.node, ways, context.preview),
        durations=approvals.durations(found, context.clock()),
    )


async def _answered(request: Request, context: ConsoleContext, number: bytes) -> Response:
    # How it was answered, by the record; a service that does not say leaves it open.
    told: list[tuple[QuestionAnswer, tuple[SentencePart, ...]]] = []
    with suppress(HintedError):
        answers = await context.service.question_answers(number)
        told = [(each, approvals.answer(each)) for each in answers]
    return render(context, request, "asked.html", told=told)


async def deny(request: Request, context: ConsoleContext) -> Response:
    await read_form(request)
    number = request.path_params["id"]
    await context.service.deny_question(from_base64url(number), DENIED)
    return RedirectResponse(f"/ask/{number}", 303)


ASK_PAGES: Final = (Page("/ask/{id}", ("GET",), show_ask), Page("/ask/{id}/deny", ("POST",), deny))

_SHOWN: Final = 200  # rights


async def show_policy(request: Request, context: ConsoleContext) -> Response:
    """What the policy file would give and take, to be approved as a whole."""
    found = await context.service.policy()
    return render(
        context,
        request,
        "policy.html",
        live=True,
        policy=found,
        gives=[sentence(each, "may") for each in found.gives[:_SHOWN]],
        takes=[sentence(each, "no longer may") for each in found.takes[:_SHOWN]],
        more=max(0, len(found.gives) - _SHOWN) + max(0, len(found.takes) - _SHOWN),
    )


async def show_delegate(request: Request, context: ConsoleContext) -> Response:
    return render(context, request, "delegate.html")


async def show_intermediate(request: Request, context: ConsoleContext) -> Response:
    return render(context, request, "intermediate.html", csr="", key=None, problem=None)


async def check_request(request: Request, context: ConsoleContext) -> Response:
    text = text_field(await read_form(request), "csr", MAX_BODY)
    try:
        key = check_intermediate_request(certificate_request(text), context.settings.domain)
    except HintedError as error:
        return render(context, request, "intermediate.html", 422, csr=text, key=None, problem=error)
    return render(context, request, "intermediate.html", csr=text, key=thumbprint(key), problem=None)


def sentence(right: PolicyRight, verb: str) -> tuple[SentencePart, ...]:
    detail = ", ".join(filter(None, (right.restriction, right.until)))
    return (
        SentencePart(words.name(right.node), is_name=True),
        SentencePart(f"{verb} {wanted(right.right)}"),
        SentencePart(words.topic(right.pattern), is_name=True),
        *([SentencePart(f"({detail})")] if detail else []),
    )


POLICY_PAGES: Final = (
    Page("/policy", ("GET",), show_policy),
    Page("/delegate", ("GET",), show_delegate),
    Page("/intermediate", ("GET",), show_intermediate),
    Page("/intermediate", ("POST",), check_request),
)

REFRESH: Final = 2  # seconds until the page looks again
MAX_NUMBER: Final = 1 << 53
_EMPTY: Final[Mapping[str, str]] = {"reason": "", "name": ""}


async def ask_grant(request: Request, context: ConsoleContext) -> Response:
    return await _ask_grant(request, context)


async def _ask_grant(
    request: Request, context: ConsoleContext, problem: FormRefused | None = None, given: str = ""
) -> Response:
    node, what = await _grant(context, from_base64url(request.path_params["id"]))
    return render(
        context,
        request,
        "revoke.html",
        422 if problem else 200,
        node=node,
        what=what,
        asks_name=False,
        is_master=False,
        problem=problem,
        reason=given,
        typed="",
    )


async def revoke_grant(request: Request, context: ConsoleContext) -> Response:
    number = from_base64url(request.path_params["id"])
    form = _exactly(await read_form(request), {"reason"})
    try:
        reason = approvals.reason(form)
    except FormRefused as problem:  # said where it was typed, with a field to go on
        return await _ask_grant(request, context, problem, form["reason"])
    epoch, seq = await context.service.revoke_grant(number, reason)
    return _follow(epoch, seq, grant=to_base64url(number))


async def ask_node(request: Request, context: ConsoleContext) -> Response:
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
        context,
        request,
        "revoke.html",
        422 if problem else 200,
        node=name,
        what=(),
        asks_name=True,
        is_master=is_master_name(name),
        problem=problem,
        reason=form["reason"],
        typed=form["name"],
    )


async def revoke_node(request: Request, context: ConsoleContext) -> Response:
    name = await _node(context, f"/{request.path_params['name']}")
    form = _exactly(await read_form(request), {"reason", "name"})
    try:
        approvals.check_typed(form, name)
        reason = approvals.reason(form)
    except FormRefused as problem:
        return _ask_node(request, context, name, problem, form)
    epoch, seq = await context.service.revoke_node(name, reason)
    return _follow(epoch, seq, node=name)


async def show_ending(request: Request, context: ConsoleContext) -> Response:
    epoch, seq = (_number(request.path_params[part]) for part in ("epoch", "seq"))
    node, what = await _subject(request, context)
    standing = await context.service.standing(epoch, seq)
    locked = not standing.is_signed and (await context.service.status()).locked
    has_all = 0 < standing.nodes == standing.nodes_with_list
    answer = render(
        context,
        request,
        "revoked.html",
        standing=standing,
        node=node,
        what=what,
        locked=locked,
        has_all=has_all,
    )
    if not has_all:
        answer.headers["Refresh"] = str(REFRESH)
        return answer
    # So that it stays ended where the master, which alone knows, is away in the next moment.
    with suppress(HintedError):
        context.endings.note(await context.service.standing(0, 0), context.clock())
    return answer


async def _subject(request: Request, context: ConsoleContext) -> tuple[str, tuple[object, ...]]:
    # The node that was meant, and what it could do: as the record says, not the address.
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


REVOKE_PAGES: Final = (
    Page("/revoke/grant/{id}", ("GET",), ask_grant),
    Page("/revoke/grant/{id}", ("POST",), revoke_grant),
    Page("/revoke/node/{name:path}", ("GET",), ask_node),
    Page("/revoke/node/{name:path}", ("POST",), revoke_node),
    Page("/revoked/{epoch}/{seq}", ("GET",), show_ending),
)

"""What is decided: a request for grants, the policy, renewals, other hosts that sign; and what is ended.

Taking away is never harder than giving: a session is enough, and while the key is locked the revocation is
recorded and signed at unlock.
"""

from collections.abc import Mapping
from contextlib import suppress
from types import MappingProxyType
from typing import Final
from urllib.parse import urlencode

from starlette.responses import Response

from ca.approvals.passkeys import base64url
from ca.certificates import check_intermediate_request
from ca.errors import HintedError
from ca.keys.signing import thumbprint
from ca.names import is_master_name
from rossec.authority.console.messages import FactView, PolicyRight, QuestionAnswer
from rossec.console import approvals
from rossec.console.matrix import held_grants
from rossec.console.rendering import MAX_BODY, PageList, Visit, from_base64url, go, text_field
from rossec.console.sentences import Sayable, name_part, permissions, say, topic_part, wanted
from rossec.errors import FormRefused, HttpRefused

PAGES: Final = PageList()
DENIED: Final = "denied at the console"
_MOST: Final = 8  # filters that are tried out on one page


@PAGES.get("/ask/{id}")
async def show_ask(visit: Visit) -> Response:
    number, context = visit.id, visit.context
    questions = await visit.service.questions()
    found = next((each for each in questions if each.id == number), None)
    if found is None:
        # How it was answered, by the record; a service that does not say leaves it open.
        told: list[tuple[QuestionAnswer, Sayable]] = []
        with suppress(HintedError):
            answers = await visit.service.question_answers(number)
            told = [(each, approvals.answer(each)) for each in answers]
        return visit.show("asked.html", told=told)
    coarse = found.coarse[-_MOST:]  # the last are rossec's own, and hide most
    ways = [("", found.rights)]
    for name in coarse:
        with suppress(HintedError):  # this filter does not fit these messages
            ways.append((name, await visit.service.consider(number, name, 0)))
    facts: tuple[FactView, ...] = ()
    with suppress(HintedError):
        facts = await visit.service.graph()
    return visit.show(
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


@PAGES.post("/ask/{id}/deny")
async def deny(visit: Visit) -> Response:
    await visit.form()
    await visit.service.deny_question(visit.id, DENIED)
    return go(f"/ask/{visit.path['id']}")


_SHOWN: Final = 200  # rights


@PAGES.get("/policy")
async def show_policy(visit: Visit) -> Response:
    found = await visit.service.policy()
    return visit.show(
        "policy.html",
        live=True,
        policy=found,
        gives=[sentence(each, "may") for each in found.gives[:_SHOWN]],
        takes=[sentence(each, "no longer may") for each in found.takes[:_SHOWN]],
        more=max(0, len(found.gives) - _SHOWN) + max(0, len(found.takes) - _SHOWN),
    )


@PAGES.get("/delegate")
async def show_delegate(visit: Visit) -> Response:
    return visit.show("delegate.html")


@PAGES.get("/intermediate")
async def show_intermediate(visit: Visit) -> Response:
    return visit.show("intermediate.html", csr="", key=None, problem=None)


@PAGES.post("/intermediate")
async def check_request(visit: Visit) -> Response:
    text = text_field(await visit.form(), "csr", MAX_BODY)
    try:
        key = check_intermediate_request(approvals.certificate_request(text), visit.context.settings.domain)
    except HintedError as error:
        return visit.show("intermediate.html", 422, csr=text, key=None, problem=error)
    return visit.show("intermediate.html", csr=text, key=thumbprint(key), problem=None)


def sentence(right: PolicyRight, verb: str) -> Sayable:
    detail = ", ".join(filter(None, (right.restriction, right.until)))
    said = [f"({detail})"] if detail else []
    return say(name_part(right.node), f"{verb} {wanted(right.right)}", topic_part(right.pattern), *said)


REFRESH: Final = 2  # seconds until the page looks again


@PAGES.get("/revoke/grant/{id}")
async def ask_grant(visit: Visit) -> Response:
    return _ask(visit, *await _grant(visit, visit.id))


@PAGES.post("/revoke/grant/{id}")
async def revoke_grant(visit: Visit) -> Response:
    number = visit.id
    form = _exactly(await visit.form(), {"reason"})
    try:
        reason = approvals.reason(form)
    except FormRefused as problem:  # said where it was typed, with a field to go on
        return _ask(visit, *await _grant(visit, number), problem=problem, form=form)
    epoch, seq = await visit.service.revoke_grant(number, reason)
    return go(f"/revoked/{epoch}/{seq}?{urlencode({'grant': base64url(number)})}")


@PAGES.get("/revoke/node/{name:path}")
async def ask_node(visit: Visit) -> Response:
    return _ask(visit, await _node(visit, f"/{visit.path['name']}"), asks_name=True)


@PAGES.post("/revoke/node/{name:path}")
async def revoke_node(visit: Visit) -> Response:
    name = await _node(visit, f"/{visit.path['name']}")
    form = _exactly(await visit.form(), {"reason", "name"})
    try:
        # A whole node loses all that it may do: its name is typed, so that no other is meant.
        approvals.check_typed(form, name)
        reason = approvals.reason(form)
    except FormRefused as problem:
        return _ask(visit, name, asks_name=True, problem=problem, form=form)
    epoch, seq = await visit.service.revoke_node(name, reason)
    return go(f"/revoked/{epoch}/{seq}?{urlencode({'node': name})}")


def _ask(
    visit: Visit,
    node: str,
    what: Sayable = (),
    *,
    asks_name: bool = False,
    problem: FormRefused | None = None,
    form: Mapping[str, str] = MappingProxyType({}),
) -> Response:
    values = {"node": node, "what": what, "asks_name": asks_name, "problem": problem}
    values |= {"reason": form.get("reason", ""), "typed": form.get("name", "")}
    is_master = asks_name and is_master_name(node)
    return visit.show("revoke.html", 422 if problem else 200, is_master=is_master, **values)


@PAGES.get("/revoked/{epoch}/{seq}")
async def show_ending(visit: Visit) -> Response:
    epoch, seq = (_number(visit.path[part]) for part in ("epoch", "seq"))
    # The node that was meant, and what it could do: as the record says, not the address.
    node, what = "", Sayable()
    if "grant" in visit.query:
        node, what = await _grant(visit, from_base64url(visit.query["grant"]))
    elif "node" in visit.query:
        node = await _node(visit, visit.query["node"])
    trust_status = await visit.service.trust_status(epoch, seq)
    locked = not trust_status.is_signed and (await visit.service.status()).locked
    has_all = 0 < trust_status.nodes == trust_status.nodes_with_list
    values = {"trust_status": trust_status, "node": node, "what": what, "locked": locked, "has_all": has_all}
    answer = visit.show("revoked.html", **values)
    if not has_all:
        answer.headers["Refresh"] = str(REFRESH)
        return answer
    # So that it stays ended where the master, which alone knows, is away in the next moment.
    with suppress(HintedError):
        visit.context.endings.note(await visit.service.trust_status(0, 0), visit.context.clock())
    return answer


async def _grant(visit: Visit, number: bytes) -> tuple[str, Sayable]:
    views = [each for each in await visit.service.grants() if each.id == number]
    nodes, now = await visit.service.nodes(), visit.context.clock()
    held = held_grants(nodes, views, now, visit.context.endings.heard)
    if not views:
        raise HttpRefused("there is no such grant", "it has ended long ago", status=404)
    return views[0].node, permissions(held[0].grant.permissions) if held else ()


async def _node(visit: Visit, name: str) -> str:
    if all(each.name != name for each in await visit.service.nodes()):
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

"""Logging in, the phones that approve, and approving itself.

Whether a code or a passkey is right is decided by the authority's service: a console that lies about what it
shows can ask for another signature, but not without the phone, and the record keeps it.
"""

import secrets
from collections.abc import Awaitable
from typing import Any, Final, NamedTuple, TypeVar

from starlette.responses import JSONResponse, Response

from ca.approvals.passkeys import base64url
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
from rossec.console.options import MAX_PHONE_NAME
from rossec.console.rendering import PUBLIC, PageList, Visit, bytes_field, go, text_field
from rossec.console.sentences import SentencePart, permission
from rossec.console.sessions import COOKIE, COOKIE_SIZE
from rossec.errors import HttpRefused, KeyServiceFailed

_T = TypeVar("_T")
PAGES: Final = PageList()
FIRST: Final = "/"  # the page after a login


@PAGES.get("/login", PUBLIC)
async def show_login(visit: Visit) -> Response:
    return visit.show("login.html", problem="")


# A code is in the fragment of the address it comes with, which browsers send to nobody; the page takes it out
# and posts it. It is used once, to look here, or with the new passkey that it adds (`add_phone`): so nobody
# who only has a session can add one.
@PAGES.post("/login", PUBLIC, looks=True)
async def look(visit: Visit) -> Response:
    form = await visit.form()
    try:
        check_pause(visit)
        code = text_field(form, "code").strip()
        await counted(visit, visit.service.redeem(code))
    except HttpRefused as error:
        return visit.show("login.html", error.status, problem=f"{error}: {error.hint}")
    return _begin(visit, go(FIRST), "")


@PAGES.post("/login/challenge", PUBLIC, looks=True)
async def challenge(visit: Visit) -> Response:
    await visit.json()
    with visit.context.turns.wait(visit.address):
        made = await visit.service.login_challenge(visit.context.settings.origin)
    return JSONResponse(challenge_fields(made, visit.context.clock()))


@PAGES.post("/login/passkey", PUBLIC, looks=True)
async def log_in(visit: Visit) -> Response:
    check_pause(visit)
    fields = await visit.json()
    phone = await counted(visit, visit.service.login(bytes_field(fields, "id"), read_assertion(fields)))
    return _begin(visit, JSONResponse({"next": FIRST}), phone)


@PAGES.post("/login/new", PUBLIC)
async def new(visit: Visit) -> Response:
    await visit.json()
    settings = visit.context.settings
    with visit.context.turns.wait(visit.address):
        made = await visit.service.new_passkey(settings.origin, settings.rp_id)
    return JSONResponse(challenge_fields(made, visit.context.clock()))


@PAGES.post("/login/phone", PUBLIC)
async def add_phone(visit: Visit) -> Response:
    check_pause(visit)
    view = await counted(visit, visit.service.add_passkey(read_registration(await visit.json())))
    return _begin(visit, JSONResponse({"next": FIRST}), view.name)


@PAGES.post("/logout", looks=True)
async def log_out(visit: Visit) -> Response:
    visit.context.sessions.end(visit.session)
    response = go("/login")
    response.delete_cookie(COOKIE, path="/", secure=True, httponly=True, samesite="strict")
    return response


def challenge_fields(made: LoginChallenge | Prepared, now: int) -> dict[str, object]:
    """A challenge as `approve.js` reads it; the timeout is in milliseconds."""
    return {
        "id": base64url(made.id),
        "challenge": base64url(made.challenge),
        "credentials": [base64url(each) for each in made.credentials],
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


def check_pause(visit: Visit) -> None:
    # Refused before anything is read or asked: noise of one address does not reach the authority.
    if visit.context.failures.is_blocked(visit.address, visit.context.elapsed()):
        raise HttpRefused("too many attempts", "wait a minute", status=429)


async def counted(visit: Visit, asking: Awaitable[_T]) -> _T:
    try:
        return await asking
    except KeyServiceFailed:
        raise
    except HintedError as error:
        visit.context.failures.note(visit.address, visit.context.elapsed())
        raise HttpRefused(str(error), error.hint, status=403) from error


def _begin(visit: Visit, response: Response, phone: str) -> Response:
    secret = secrets.token_bytes(COOKIE_SIZE)
    value = visit.context.sessions.begin(secret, phone, visit.context.elapsed())
    # `strict`: no other site's link or form brings the cookie along (CSRF, before `Origin` is looked at).
    age = visit.context.settings.lifetime
    response.set_cookie(COOKIE, value, age, path="/", secure=True, httponly=True, samesite="strict")
    return response


REMOVED: Final = "removed at the console"


@PAGES.get("/phones")
async def show_phones(visit: Visit) -> Response:
    phones, proposals = await visit.service.phones(), await visit.service.proposals()
    current = [phone for phone in phones if not phone.ended]
    ended = [phone for phone in phones if phone.ended]
    return visit.show("phones.html", live=True, phones=current, proposals=proposals, ended=ended)


# A second phone comes by a link and shows digits, and the first approves it.
@PAGES.post("/phones/link")
async def link(visit: Visit) -> Response:
    await visit.form()
    code = await visit.service.phone_link(visit.owner)
    address = f"{visit.context.settings.origin}/propose#{code}"
    return visit.show("phone_link.html", address=address, code=qr.inline_svg(address))


# Removing one takes something away, so it needs no passkey; nor does ending one that waits.
@PAGES.post("/phones/{id}/remove")
async def remove(visit: Visit) -> Response:
    await visit.form()
    phone = visit.id
    names = [each.name for each in await visit.service.phones() if each.id == phone]
    await visit.service.remove_phone(phone, REMOVED)
    own = visit.session.phone in names
    for name in names:
        visit.context.sessions.end_of_phone(name)
    return go("/login" if own else "/phones")


@PAGES.post("/phones/{id}/differ")
async def differ(visit: Visit) -> Response:
    await visit.form()
    await visit.service.end_proposal(visit.id)
    return go("/phones")


@PAGES.get("/propose", PUBLIC)
async def ask(visit: Visit) -> Response:
    return visit.show("propose.html")


@PAGES.post("/propose", PUBLIC)
async def propose(visit: Visit) -> Response:
    check_pause(visit)
    proposing = visit.service.propose_passkey(read_registration(await visit.json()))
    proposal = await counted(visit, proposing)
    return JSONResponse({"digits": group_digits(proposal.digits)})


@PAGES.post("/prepare/{kind}")
async def prepare(visit: Visit) -> Response:
    # The act is kept for this session, and what comes back from the phone is only its signature: what was
    # shown is what is carried on.
    act = await approvals.read(visit.context, visit.path["kind"], await visit.form())
    owner = visit.owner
    made = await visit.service.prepare(act.kind, [*act.arguments], owner)
    if not made.credentials:
        raise HttpRefused(
            "no phone is set up", "get a code at the terminal: rossec console phone", status=409
        )
    if not visit.context.pending.add(made.id, visit.session.id, act, owner):
        raise HttpRefused("too much waits for a phone", "approve that, or wait", status=429)
    return JSONResponse(challenge_fields(made, visit.context.clock()))


@PAGES.post("/approve/{id}")
async def approve(visit: Visit) -> Response:
    statement = visit.id
    session = visit.session.id
    act = visit.context.pending.get(statement, session)
    if act is None:
        raise HttpRefused("this was not asked here", "load the page again", status=404)
    outcome = await visit.service.approve(statement, read_assertion(await visit.json()))
    # After it was used: the service takes a statement once in any case (forged-approval).
    visit.context.pending.pop(statement, session)
    return JSONResponse({"next": approvals.carried_out(visit.context, act, outcome, session)})


_RECENT: Final = 200


class Given(NamedTuple):
    node: str
    parts: tuple[SentencePart, ...]
    words: str
    until: int


@PAGES.get("/approved/{id}")
async def show_approved(visit: Visit) -> Response:
    number = visit.id
    outcome = await visit.service.outcome(number)
    approvals = await visit.service.approvals(_RECENT)
    approval = next((each for each in approvals if each.id == number), None)
    # Of what was made, a bundle for another host is carried there; a join code is for `/invited`.
    kind = None if approval is None else approval.kind
    is_carried = kind == StatementKind.INTERMEDIATE
    is_waiting = outcome.state == "waiting"
    return visit.show(
        "approved.html",
        live=is_waiting,
        outcome=outcome,
        locked=is_waiting and (await visit.service.status()).locked,
        approval=approval,
        given=_given(outcome.data) if kind == StatementKind.GRANT else (),
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
    made = []
    for grant in grants:
        for each in grant.permissions:
            plain = words.plain(filter(None, [each.restriction]))
            made.append(Given(grant.subject, permission(each)[:2], plain, max(grant.expires, grant.cap)))
    return made

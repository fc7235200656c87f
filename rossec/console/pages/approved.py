"""What came of an approval: done, waiting for the key or the master, or why not."""

from typing import Final, NamedTuple

from starlette.requests import Request
from starlette.responses import Response

from ca.approvals.statement import MAX_PAYLOAD, Kind
from ca.encoding import decode
from ca.errors import EncodingError
from grants import claims
from grants.errors import GrantError
from grants.model import ID_SIZE
from rossec.console import words
from rossec.console.context import ConsoleContext
from rossec.console.forms import from_base64url
from rossec.console.rendering import render
from rossec.console.routing import Page
from rossec.console.sentences import Part, permission

_RECENT: Final = 200


class Given(NamedTuple):
    """A right that was given: of whom, what, how coarse in words (empty: all of it), until when."""

    node: str
    parts: tuple[Part, ...]
    words: str
    until: int


async def show(request: Request, context: ConsoleContext) -> Response:
    """One approval, until it is done.

    Raises:
        HintedError: there is none with this id.
    """
    number = from_base64url(request.path_params["id"])
    outcome = await context.service.outcome(number)
    approvals = await context.service.approvals(_RECENT)
    approval = next((each for each in approvals if each.id == number), None)
    # Of what was made, a bundle for another host is carried there; a join code is for `/invited`.
    is_carried = approval is not None and approval.kind == Kind.INTERMEDIATE
    of_grant = approval is not None and approval.kind == Kind.GRANT
    is_waiting = outcome.state == "waiting"
    locked = is_waiting and (await context.service.status()).locked
    return render(
        context, request, "approved.html", live=is_waiting, outcome=outcome, locked=locked,
        approval=approval, given=_given(outcome.data) if of_grant else (),
        carried=outcome.data.decode(errors="replace") if is_carried else "",
    )  # fmt: skip


def _given(data: bytes) -> list[Given]:
    """What the grants with these claims give; nothing if they cannot be read, or are not made."""
    try:
        bodies = decode(data, limit=MAX_PAYLOAD) if data else []
        found = bodies if isinstance(bodies, list) else []
        grants = [claims.read(body, bytes(ID_SIZE)) for body in found if isinstance(body, bytes)]
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


PAGES: Final = (Page("/approved/{id}", ("GET",), show),)

"""One node: its identity, what it sees and sends, its grants; and one grant."""

from typing import Final, NamedTuple

from starlette.requests import Request
from starlette.responses import Response

from ca.names import is_master_name
from rossec.console import overview, words
from rossec.console.context import ConsoleContext
from rossec.console.forms import from_base64url
from rossec.console.matrix import Access, Cell, HeldGrant, Matrix, TopicRow
from rossec.console.overview import Overview
from rossec.console.rendering import names_of, render
from rossec.console.routing import Page
from rossec.console.sentences import Known, Part, permission, permissions, story
from rossec.errors import HttpRefused

MAX_ROWS: Final = 40
MAX_GRANTS: Final = 30
THINGS: Final = 6
_ENTRIES: Final = 200


class GrantLine(NamedTuple):
    """A grant in a list: what it gives, and how long or why no longer."""

    id: bytes
    parts: tuple[Part, ...]
    term: str
    ended: bool
    reason: str
    ending: bool = False


class PermissionLine(NamedTuple):
    """One permission of a grant, in words and as it is signed."""

    parts: tuple[Part, ...]
    words: str
    exact: tuple[str, ...]


async def show(request: Request, context: ConsoleContext) -> Response:
    """One node."""
    name = overview.name_of(request.path_params["name"])
    home = await overview.load(context, names_of(request))
    identities = home.named(name)
    if not identities:
        raise HttpRefused(
            f"no node has the name {words.name(name)}", "see who sees what", status=404
        )
    now = context.clock()
    grants = [grant_line(each, now) for each in home.held if each.grant.subject == name]
    grants.sort(key=lambda line: line.ended)
    seen = sees(home.matrix, name)
    sent = [row for row in home.matrix.rows if name in row.publishers]
    events = await context.service.events(0, _ENTRIES)
    known = Known.of(home.held, home.nodes, ending=home.ending)
    told = [each for each in story(events, await overview.denials(context), known)
            if each.node == name]  # fmt: skip
    return render(
        context, request, "node.html", live=True, name=name, identities=identities,
        seen=seen[:MAX_ROWS], sent=sent[:MAX_ROWS], grants=grants[:MAX_GRANTS],
        more_seen=max(0, len(seen) - MAX_ROWS), more_sent=max(0, len(sent) - MAX_ROWS),
        more_grants=max(0, len(grants) - MAX_GRANTS), sentences=told[:THINGS],
        is_master=is_master_name(name), without_master=home.without_master,
        is_ending=identities[0].key.hex() in home.ending, again=overview.again(home),
    )  # fmt: skip


def sees(matrix: Matrix, name: str) -> list[tuple[TopicRow, Cell]]:
    """The topics that a node sees, or saw, what it sees now first."""
    found = [
        (row, cell)
        for row in matrix.rows
        for cell in row.cells
        if cell.receiver == name and cell.access is not Access.NOTHING
    ]
    return sorted(found, key=lambda item: (item[1].access is Access.ENDED, item[0].topic))


def grant_line(held: HeldGrant, now: int) -> GrantLine:
    """A grant in one line."""
    term = words.term(held.grant.expires, held.view.cap, now)
    if held.ended_at:
        term = f"ended {words.ago(held.ended_at, now)}"
    if held.is_ending:
        term = f"was ended {words.ago(held.ended_at, now)}, and not every node has heard"
    given = permissions(held.grant.permissions)
    ended = bool(held.ended_at)
    return GrantLine(held.view.id, given, term, ended, held.reason, held.is_ending)


async def grant(request: Request, context: ConsoleContext) -> Response:
    """One grant: what it says, to whom, how long, and how it ends."""
    number = from_base64url(request.path_params["id"])
    home = await overview.load(context, names_of(request))
    held = next((each for each in home.held if each.view.id == number), None)
    if held is None:
        raise HttpRefused(
            "there is no such grant in the last 30 days", "see who sees what", status=404
        )
    lines = [
        PermissionLine(
            permission(each),
            words.restrictions([each.restriction] if each.restriction is not None else []),
            tuple(each.restriction.lines()) if each.restriction is not None else (),
        )
        for each in held.grant.permissions
    ]
    return render(
        context, request, "grant.html", live=True, held=held, lines=lines,
        line=grant_line(held, context.clock()), holder=_holder(home, held),
        without_master=home.without_master, again=overview.again(home),
    )  # fmt: skip


def _holder(home: Overview, held: HeldGrant) -> bool:
    """Whether the key that the grant is for is still one of its node."""
    return any(node.key == held.grant.holder and not node.revoked_at for node in home.nodes)


PAGES: Final = (
    Page("/node/{name:path}", ("GET",), show),
    Page("/grant/{id}", ("GET",), grant),
)

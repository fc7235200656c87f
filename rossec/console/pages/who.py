"""Who sees what: the whole matrix, a part at a time, and one topic as each receiver sees it."""

from typing import Final, NamedTuple

from starlette.requests import Request
from starlette.responses import Response

from grants.model import Right
from rossec.console import overview, words
from rossec.console.context import ConsoleContext
from rossec.console.matrix import Access, HeldGrant, TopicRow
from rossec.console.rendering import names_of, render
from rossec.console.routing import Page
from rossec.errors import HttpRefused

ROWS: Final = 12
RECEIVERS: Final = 4
MAX_OTHERS: Final = 60
MAX_CELLS: Final = 40
_OTHER: Final = ~(Right.SUBSCRIBE | Right.PUBLISH)


class OtherRight(NamedTuple):
    """A right that shows or changes something beside topics."""

    node: str
    what: str
    pattern: str
    grant: bytes


async def show(request: Request, context: ConsoleContext) -> Response:
    """The matrix from a row and a receiver on, and what nodes may do beside seeing topics."""
    home = await overview.load(context, names_of(request))
    row = overview.position(request.query_params.get("row"))
    receiver = overview.position(request.query_params.get("receiver"))
    part = home.matrix.window(slice(row, row + ROWS), slice(receiver, receiver + RECEIVERS))
    others = other_rights(home.held)
    return render(
        context, request, "who.html", live=True, matrix=part, row=row, receiver=receiver,
        rows=len(home.matrix.rows), receivers=len(home.matrix.receivers),
        page_rows=ROWS, page_receivers=RECEIVERS,
        others=others[:MAX_OTHERS], more=max(0, len(others) - MAX_OTHERS),
        without_master=home.without_master, again=overview.again(home),
    )  # fmt: skip


def other_rights(held: tuple[HeldGrant, ...]) -> list[OtherRight]:
    """Calls, settings and administration that are granted now, by node."""
    found = [
        OtherRight(each.grant.subject,
                   "still " * each.is_ending + words.rights(permission.rights & _OTHER),
                   words.topic(permission.pattern), each.view.id)
        for each in held
        for permission in each.grant.permissions
        if not each.is_over and permission.rights & _OTHER
    ]  # fmt: skip
    return sorted(set(found))


async def see(request: Request, context: ConsoleContext) -> Response:
    """One topic: who sends it, and what it looks like to each receiver."""
    name = overview.name_of(request.path_params["topic"])
    home = await overview.load(context, names_of(request))
    row = home.matrix.row(name)
    if row is None:
        raise HttpRefused(
            f"no grant and no node names {words.name(name)}", "see who sees what", status=404
        )
    cells = sorted(row.cells, key=lambda cell: (_order(row, cell.receiver), cell.receiver))
    return render(
        context, request, "see.html", live=True, row=row, cells=cells[:MAX_CELLS],
        more=max(0, len(cells) - MAX_CELLS), comparison=overview.comparison(context, row),
        without_master=home.without_master, again=overview.again(home),
    )  # fmt: skip


def _order(row: TopicRow, receiver: str) -> int:
    access = next(cell.access for cell in row.cells if cell.receiver == receiver)
    return [*Access].index(access)


PAGES: Final = (Page("/who", ("GET",), show), Page("/see/{topic:path}", ("GET",), see))

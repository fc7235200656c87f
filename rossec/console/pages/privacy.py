"""The report to print: every field, every receiver, how, why, until when, of all that is granted.

`rossec privacy --html` writes the same from the policy, as a file of its own (`write`).
"""

from collections.abc import Sequence
from typing import Final

from starlette.requests import Request
from starlette.responses import Response

from rossec.console import overview
from rossec.console.assets import FOLDER
from rossec.console.context import ConsoleContext
from rossec.console.names import NONE, Names
from rossec.console.rendering import names_of, render, render_text
from rossec.console.report import ReportTopic, held_accesses, topics
from rossec.console.routing import Page
from rossec.participant.host_types import layout_of

TOPICS: Final = 12  # on one page


async def show(request: Request, context: ConsoleContext) -> Response:
    """The report of what is granted now."""
    home = await overview.load(context, names_of(request))
    first = overview.position(request.query_params.get("row"))
    types = {fact.name: fact.node for fact in home.facts if fact.kind == "type"}
    found = topics(held_accesses(home.held, types, names_of(request).type_of), layout_of)
    return render(
        context, request, "privacy.html", live=True, topics=found[first : first + TOPICS],
        row=first, rows=len(found), page_rows=TOPICS, without_master=home.without_master,
        again=overview.again(home),
    )  # fmt: skip


def write(found: Sequence[ReportTopic], robot: str, now: int, names: Names = NONE) -> str:
    """The whole report as one page that needs nothing beside it."""
    style = (FOLDER / "style.css").read_text(encoding="utf-8")
    values = {"topics": found, "robot": robot, "now": now, "style": style}
    return render_text("report_alone.html", names, **values)


PAGES: Final = (Page("/privacy", ("GET",), show),)

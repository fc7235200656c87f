"""The report to print: every field, every receiver, how, why, until when, of all that is granted.

`rossec privacy --html` writes the same from the policy, as a file of its own (`write`).
"""

from collections.abc import Sequence
from typing import Final

from starlette.requests import Request
from starlette.responses import Response

from grants.filters.layout import Layout, parse
from rossec.console import overview
from rossec.console.assets import FOLDER
from rossec.console.context import ConsoleContext
from rossec.console.rendering import render, render_text
from rossec.console.report import ReportTopic, held_accesses, topics
from rossec.console.routing import Page
from rossec.participant.message_types import message_type

TOPICS: Final = 12  # on one page


async def show(request: Request, context: ConsoleContext) -> Response:
    """The report of what is granted now."""
    home = await overview.load(context)
    first = overview.position(request.query_params.get("row"))
    types = {fact.name: fact.node for fact in home.facts if fact.kind == "type"}
    found = topics(held_accesses(home.held, types), layout_of)
    return render(
        context, request, "privacy.html", topics=found[first : first + TOPICS], row=first,
        rows=len(found), page_rows=TOPICS, without_master=home.without_master,
    )  # fmt: skip


def layout_of(type_name: str) -> Layout:
    """The layout of a message type that is known here."""
    return parse(type_name, message_type(type_name).definition)


def write(found: Sequence[ReportTopic], robot: str, now: int) -> str:
    """The whole report as one page that needs nothing beside it."""
    style = (FOLDER / "style.css").read_text(encoding="utf-8")
    return render_text("report_alone.html", topics=found, robot=robot, now=now, style=style)


PAGES: Final = (Page("/privacy", ("GET",), show),)

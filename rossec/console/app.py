"""The pages as one ASGI application, behind the guard; a refusal becomes a page with its hint.

The application knows no address but those of its settings, so a request's `Host` decides nothing.
"""

import logging
from collections.abc import Awaitable, Callable
from typing import Final

from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import JSONResponse, Response
from starlette.routing import Route
from starlette.types import ASGIApp

from ca.errors import HintedError
from rossec.console.context import ConsoleContext
from rossec.console.names import NONE, Names
from rossec.console.rendering import render
from rossec.console.routes import ROUTES
from rossec.console.routing import Access, Page, for_looking
from rossec.console.server.guard import Guard, wants_json
from rossec.errors import HttpRefused, KeyServiceFailed
from rossec.ros.text import printable

CRASHED: Final = HttpRefused("something went wrong here", "it is in the log", status=500)
_log = logging.getLogger("rossec.console")


def create_app(context: ConsoleContext, pages: tuple[Page, ...] = ROUTES) -> ASGIApp:
    """The console's application; one that only shows lacks what would do more."""
    if context.settings.read_only:
        pages = for_looking(pages)
    routes = [Route(page.path, _endpoint(page, context), methods=page.methods) for page in pages]
    app = Starlette(routes=routes)
    return Guard(app, context, pages, lambda request, error: show_error(request, context, error))


def _endpoint(page: Page, context: ConsoleContext) -> Callable[[Request], Awaitable[Response]]:
    async def answer(request: Request) -> Response:
        try:
            if page.access is Access.SESSION and request.method == "GET":
                request.state.number = await context.news.ask()
            if page.access is Access.SESSION and wants_page(request):
                request.state.names = await _names(context)
            return await page.handler(request, context)
        except HintedError as error:
            return show_error(request, context, error)
        except Exception as error:  # noqa: BLE001 - logged; nothing of it reaches the browser
            _log.error("%s crashed: %s", page.path, type(error).__name__, exc_info=error)
            return show_error(request, context, CRASHED)

    return answer


def wants_page(request: Request) -> bool:
    """Whether a person will read the answer."""
    return not wants_json(request.headers)


async def _names(context: ConsoleContext) -> Names:
    """What the policy calls things; nothing from a service that does not say."""
    try:
        return Names.of(await context.service.policy_names())
    except HintedError:
        return NONE


def status_of(error: HintedError) -> int:
    """The HTTP status that says what an error says."""
    if isinstance(error, HttpRefused):
        return error.status
    return 503 if isinstance(error, KeyServiceFailed) else 422


def show_error(request: Request, context: ConsoleContext, error: HintedError) -> Response:
    """A refusal as a page, or as JSON for a script."""
    status = status_of(error)
    if wants_json(request.headers):
        told = {"error": printable(error), "hint": printable(error.hint)}
        return JSONResponse(told, status)
    return render(context, request, "error.html", status, message=str(error), hint=error.hint)

"""`/news`: that something changed, as server-sent events, to pages that are open."""

from typing import Final

from starlette.requests import Request
from starlette.responses import Response, StreamingResponse

from rossec.console.context import ConsoleContext
from rossec.console.routing import Page


async def stream(request: Request, context: ConsoleContext) -> Response:
    """A stream that ends with its session.

    Raises:
        HttpRefused: there are too many.
    """
    session = request.state.session
    is_valid = lambda: context.sessions.is_valid(session, context.elapsed())  # noqa: E731 - one expression
    return StreamingResponse(context.news.open(is_valid), media_type="text/event-stream")


PAGES: Final = (Page("/news", ("GET",), stream),)

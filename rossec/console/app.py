"""The pages as one ASGI application, behind a guard: who may ask, from where, and how much.

The first rule of `RULES` that is broken answers; a page sees only requests that broke none. A guard that
crashes answers 500 and nothing else; a refusal becomes a page with its hint. What is not in `ROUTES` does not
exist.
"""

import asyncio
import logging
from collections.abc import Awaitable, Callable, Iterable, Mapping
from contextlib import suppress
from typing import Final, NamedTuple

from starlette.applications import Starlette
from starlette.datastructures import Headers
from starlette.requests import Request
from starlette.responses import JSONResponse, RedirectResponse, Response
from starlette.routing import Route
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from ca.errors import HintedError
from rossec.console import rendering
from rossec.console.context import ConsoleContext
from rossec.console.pages import adding, decisions, passkeys, today, visibility
from rossec.console.rendering import PREFIX, Match, Page, PageAccess, PageTable, Visit, for_looking
from rossec.console.server import PLACE, WebSettings, check_peer
from rossec.console.sessions import COOKIE, LoginSession, owner_of
from rossec.console.words import Names
from rossec.errors import HttpRefused, KeyServiceFailed, PeerUserRefused
from rossec.peer_limits import printable

# No script makes HTML, so `trusted-types 'none'` holds; pictures are SVG with classes, so styles come from
# the one file. A page inside another one would make a press there a press here: `frame-ancestors 'none'`.
_POLICY: Final = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data: blob:; "
    "connect-src 'self'; media-src 'self' blob:; manifest-src 'self'; form-action 'self'; base-uri 'none'; "
    "frame-ancestors 'none'; require-trusted-types-for 'script'; trusted-types 'none'"
)
HEADERS: Final[Mapping[str, str]] = {
    "Content-Security-Policy": _POLICY,
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "same-origin",  # `no-referrer` makes `Origin: null` of own forms, which is refused
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Permissions-Policy": "camera=(self), publickey-credentials-get=(self), microphone=(), geolocation=()",
    "Cache-Control": "no-store",
}
IMMUTABLE: Final = "public, max-age=31536000, immutable"
HSTS: Final = "max-age=31536000"


def security_headers(*, immutable: bool = False, hsts: bool = False) -> list[tuple[bytes, bytes]]:
    headers = dict(HEADERS)
    if immutable:
        headers["Cache-Control"] = IMMUTABLE
    if hsts:
        headers["Strict-Transport-Security"] = HSTS
    return [(name.lower().encode(), text.encode()) for name, text in headers.items()]


BODY: Final = 20.0  # seconds for a body to arrive
WRITE: Final = 30.0  # seconds for a piece of an answer to be taken
SAFE: Final = ("GET", "HEAD")
SEE_OTHER: Final = 303
LOG_OUT: Final = "/logout"  # also when the service does not answer
CRASHED: Final = HttpRefused("something went wrong here", "it is in the log", status=500)
_log = logging.getLogger("rossec.console")


class Facts(NamedTuple):
    method: str
    hosts: tuple[str, ...]  # of every `Host` header
    origins: tuple[str, ...]
    site: str  # Sec-Fetch-Site; empty: an older browser
    length: int | None  # of the body, as announced; None: malformed
    has_session: bool


class GuardRule(NamedTuple):
    name: str
    status: int
    message: str
    hint: str


# In this order. The host first: a name that was rebound to this address (DNS) learns not even which pages
# there are. The origin before the session: a form of another site is refused whoever is logged in.
RULES: Final = (
    GuardRule("host", 421, "this is not its address", "use the printed one"),
    GuardRule("path", 404, "there is no such page", "is the address right?"),
    GuardRule("method", 405, "this page is not used in this way", "load it again"),
    GuardRule("origin", 403, "another site sent this", "load the page again"),
    GuardRule("session", SEE_OTHER, "you are not logged in", "log in"),
    GuardRule("size", 413, "this is too large", "send less"),
)
_NOT_LOGGED_IN: Final = next(rule for rule in RULES if rule.name == "session")


def broken_rule(facts: Facts, allowed: WebSettings, match: Match | None) -> GuardRule | None:
    page = None if match is None else match.page
    # Of two headers a proxy and this program might each believe another one: exactly one counts. The site is
    # asked besides the origin, since browsers count another port of localhost as the same site
    # (console-csrf).
    is_own = len(facts.origins) == 1 and facts.origins[0] in allowed.origins
    holds = {
        "host": len(facts.hosts) == 1 and facts.hosts[0] in allowed.hosts,
        "path": match is not None,
        "method": page is not None,
        "origin": facts.method in SAFE or (is_own and facts.site in {"", "same-origin"}),
        "session": page is not None and (page.access is PageAccess.PUBLIC or facts.has_session),
        "size": page is not None and facts.length is not None and facts.length <= page.max_body,
    }
    return next((rule for rule in RULES if not holds[rule.name]), None)


def wants_json(headers: Mapping[str, str]) -> bool:
    # A script, which cannot show a page.
    return headers.get("accept", "").split(",")[0].strip() in {"application/json", "text/event-stream"}


class RequestGuard:
    def __init__(self, app: ASGIApp, context: ConsoleContext, pages: Iterable[Page]) -> None:
        self._app, self._context = app, context
        self._table = PageTable(pages)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http":
            raise HttpRefused("only HTTP is served here")
        answer = _Answer(send, scope["path"], hsts=self._context.settings.hsts)
        scope["state"] = {"session": None}
        try:
            await self._pass(scope, receive, answer.send)
        except (HintedError, TimeoutError, ConnectionError) as error:
            if answer.has_begun or isinstance(error, ConnectionError):
                return
            problem: HintedError = HttpRefused("this took too long", "try it again", status=408)
            if isinstance(error, PeerUserRefused):
                problem = HttpRefused(str(error), error.hint, status=403)
            elif isinstance(error, HintedError):
                problem = error
            await self._end(scope, receive, answer.send, problem)
        except Exception as error:
            _log.error("a page crashed: %s", type(error).__name__, exc_info=error)
            if answer.has_begun:
                raise  # the connection is closed
            await self._end(scope, receive, answer.send, CRASHED)

    async def _pass(self, scope: Scope, receive: Receive, send: Send) -> None:
        # 1. Whose connection it is: another user of this host learns nothing, whatever the request says.
        check_peer(scope, self._context.settings.users)
        # 2. What its head says, by the rules in their order.
        request = Request(scope)
        session = self._session(request.headers)
        match = self._table.find(scope["path"], scope["method"])
        rule = broken_rule(facts_of(scope, has_session=session is not None), self._context.settings, match)
        if rule is not None:
            await self._answer(rule, match, request)(scope, receive, send)
            return
        # 3. Strangers who hold all connections end none of this one's from now on.
        scope["state"]["session"] = session
        if session is not None and (place := scope.get(PLACE)) is not None:
            place.belongs_to(owner_of(session))
        # 4. The body: bounded and whole before the page runs, so that no page waits for a stranger.
        limit = 0 if match is None or match.page is None else match.page.max_body
        body = bytearray()
        async with asyncio.timeout(BODY):
            more = True
            while more:
                message = await receive()
                if message["type"] != "http.request":
                    raise ConnectionResetError
                body += message.get("body", b"")
                if len(body) > limit:
                    raise HttpRefused("this is too large", "send less", status=413)
                more = message.get("more_body", False)
        # 5. Whether the phone that began the session is still known: last, since it asks the service.
        if not await self._counts(session, match):
            await self._answer(_NOT_LOGGED_IN, match, request)(scope, receive, send)
            return
        again: list[Message] = [{"type": "http.request", "body": bytes(body), "more_body": False}]

        async def read() -> Message:
            return again.pop() if again else await receive()

        await self._app(scope, read, send)

    async def _counts(self, session: LoginSession | None, match: Match | None) -> bool:
        # Whether the phone that began a session was not removed; if it was, the session ends.
        page = None if match is None else match.page
        if session is None or page is None or page.access is PageAccess.PUBLIC or page.path == LOG_OUT:
            return True
        counts = await self._context.phones.counts(session)
        if not counts:
            self._context.sessions.end(session)
        return counts

    def _answer(self, rule: GuardRule, match: Match | None, request: Request) -> Response:
        response: Response
        if rule.status == SEE_OTHER and not wants_json(request.headers):
            response = RedirectResponse("/login", SEE_OTHER)
        else:
            status = 401 if rule.status == SEE_OTHER else rule.status
            response = show_error(request, self._context, HttpRefused(rule.message, rule.hint, status=status))
        if rule.name == "method" and match is not None:
            response.headers["Allow"] = ", ".join(sorted(match.methods))
        # RFC 9112 section 6: a request has a body by one of these; it is not read.
        if request.headers.get("content-length", "0") != "0" or "transfer-encoding" in request.headers:
            response.headers["Connection"] = "close"
        return response

    async def _end(self, scope: Scope, receive: Receive, send: Send, error: HintedError) -> None:
        response = show_error(Request(scope), self._context, error)
        response.headers["Connection"] = "close"
        await response(scope, receive, send)

    def _session(self, headers: Headers) -> LoginSession | None:
        now = self._context.elapsed()
        pieces = (piece.strip().partition("=") for piece in ";".join(headers.getlist("cookie")).split(";"))
        cookies = [value for name, _, value in pieces if name == COOKIE]
        # Of two, a browser does not say which is this host's own: neither counts.
        found = self._context.sessions.find(cookies[0] if len(cookies) == 1 else "", now)
        if found is not None and is_by_person(headers):
            found.used = now
        return found


def is_by_person(headers: Mapping[str, str]) -> bool:
    # Browsers say so of navigations (`Sec-Fetch-User`); older ones send none of these headers. What a page
    # does by itself, such as loading itself again, keeps no session alive.
    if "sec-fetch-mode" not in headers or headers.get("sec-fetch-user") == "?1":
        return True
    return headers.get("content-type") is not None  # a form or an approval


def facts_of(scope: Scope, *, has_session: bool) -> Facts:
    headers = Headers(scope=scope)
    lengths = headers.getlist("content-length") or ["0"]
    is_number = len(lengths) == 1 and lengths[0].isascii() and lengths[0].isdigit()
    return Facts(
        scope["method"],
        tuple(headers.getlist("host")),
        tuple(headers.getlist("origin")),
        headers.get("sec-fetch-site", ""),
        int(lengths[0]) if is_number else None,
        has_session,
    )


class _Answer:
    def __init__(self, send: Send, path: str, *, hsts: bool) -> None:
        self._send, self._path, self._hsts = send, path, hsts
        self.has_begun = False

    async def send(self, message: Message) -> None:
        if message["type"] == "http.response.start":
            self.has_begun = True
            immutable = self._path.startswith(PREFIX) and message["status"] == 200
            added = security_headers(immutable=immutable, hsts=self._hsts)
            names = {name for name, _ in added}
            kept = [pair for pair in message.get("headers", ()) if pair[0].lower() not in names]
            message = {**message, "headers": [*kept, *added]}
        async with asyncio.timeout(WRITE):
            await self._send(message)


ROUTES: Final[tuple[Page, ...]] = (
    *rendering.ASSET_PAGES,
    *passkeys.PAGES,
    *today.PAGES,
    *adding.PAGES,
    *decisions.PAGES,
    *visibility.PAGES,
)


def create_app(context: ConsoleContext, pages: tuple[Page, ...] = ROUTES) -> ASGIApp:
    """The console's application; one that only shows lacks what would do more."""
    if context.settings.read_only:
        pages = for_looking(pages)

    def endpoint(page: Page) -> Callable[[Request], Awaitable[Response]]:
        async def answer(request: Request) -> Response:
            try:
                if page.access is PageAccess.SESSION and request.method == "GET":
                    request.state.number = await context.news.ask()
                if page.access is PageAccess.SESSION and not wants_json(request.headers):
                    with suppress(HintedError):  # a service that does not say what the policy calls things
                        request.state.names = Names.of(await context.service.policy_names())
                return await page.handler(Visit(request, context))
            except HintedError as error:
                return show_error(request, context, error)
            except Exception as error:  # noqa: BLE001 - logged; nothing of it reaches the browser
                _log.error("%s crashed: %s", page.path, type(error).__name__, exc_info=error)
                return show_error(request, context, CRASHED)

        return answer

    app = Starlette(routes=[Route(page.path, endpoint(page), methods=page.methods) for page in pages])
    return RequestGuard(app, context, pages)


def status_of(error: HintedError) -> int:
    if isinstance(error, HttpRefused):
        return error.status
    return 503 if isinstance(error, KeyServiceFailed) else 422


def show_error(request: Request, context: ConsoleContext, error: HintedError) -> Response:
    status = status_of(error)
    if wants_json(request.headers):
        told = {"error": printable(error), "hint": printable(error.hint)}
        return JSONResponse(told, status)
    return Visit(request, context).show("error.html", status, message=str(error), hint=error.hint)

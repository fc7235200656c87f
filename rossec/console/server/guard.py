"""What stands before every page: who may ask, from where, and how much. Decisions are a table.

The first rule that is broken answers; a page sees only requests that broke none. `Host` is checked
against DNS rebinding, `Origin` and `Sec-Fetch-Site` against forms of other sites; the session is
looked up by its cookie; a body is read here, bounded in size and time, before the page runs. A
guard that crashes answers 500 and nothing else.
"""

import asyncio
import logging
from collections.abc import Callable, Iterable, Mapping
from typing import Final, NamedTuple

from starlette.datastructures import Headers
from starlette.requests import Request
from starlette.responses import RedirectResponse, Response
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from ca.errors import HintedError
from rossec.console.assets import PREFIX
from rossec.console.context import ConsoleContext
from rossec.console.headers import security_headers
from rossec.console.routing import Access, Match, Page, PageTable
from rossec.console.server.peer import check_peer
from rossec.console.server.serving import PLACE
from rossec.console.sessions import COOKIE, Session, owner_of
from rossec.errors import HttpRefused, PeerUserRefused

BODY: Final = 20.0  # seconds for a body to arrive
WRITE: Final = 30.0  # seconds for a piece of an answer to be taken
SAFE: Final = ("GET", "HEAD")
SEE_OTHER: Final = 303
LOG_OUT: Final = "/logout"  # also when the service does not answer
_log = logging.getLogger("rossec.console")


class Facts(NamedTuple):
    """What a request says, as far as the rules ask."""

    method: str
    hosts: tuple[str, ...]  # of every `Host` header
    origins: tuple[str, ...]
    site: str  # Sec-Fetch-Site; empty: an older browser
    length: int | None  # of the body, as announced; None: malformed
    has_session: bool


class GuardRule(NamedTuple):
    """What must hold, and the answer where it does not."""

    name: str
    holds: Callable[[Facts, "Allowed", Match | None], bool]
    status: int
    message: str
    hint: str


class Allowed(NamedTuple):
    """The addresses of this console."""

    hosts: frozenset[str]
    origins: tuple[str, ...]


def _is_own_host(facts: Facts, allowed: Allowed, _match: Match | None) -> bool:
    return len(facts.hosts) == 1 and facts.hosts[0] in allowed.hosts


def _exists(_facts: Facts, _allowed: Allowed, match: Match | None) -> bool:
    return match is not None


def _has_method(_facts: Facts, _allowed: Allowed, match: Match | None) -> bool:
    return match is not None and match.page is not None


def _is_own_origin(facts: Facts, allowed: Allowed, _match: Match | None) -> bool:
    if facts.method in SAFE:
        return True
    own = len(facts.origins) == 1 and facts.origins[0] in allowed.origins
    return own and facts.site in {"", "same-origin"}


def _may_see(facts: Facts, _allowed: Allowed, match: Match | None) -> bool:
    page = None if match is None else match.page
    return page is not None and (page.access is Access.PUBLIC or facts.has_session)


def _is_bounded(facts: Facts, _allowed: Allowed, match: Match | None) -> bool:
    page = None if match is None else match.page
    return page is not None and facts.length is not None and facts.length <= page.max_body


RULES: Final = (
    GuardRule("host", _is_own_host, 421, "this is not its address", "use the printed one"),
    GuardRule("path", _exists, 404, "there is no such page", "is the address right?"),
    GuardRule("method", _has_method, 405, "this page is not used in this way", "load it again"),
    GuardRule("origin", _is_own_origin, 403, "another site sent this", "load the page again"),
    GuardRule("session", _may_see, SEE_OTHER, "you are not logged in", "log in"),
    GuardRule("size", _is_bounded, 413, "this is too large", "send less"),
)  # fmt: skip
_NOT_LOGGED_IN: Final = next(rule for rule in RULES if rule.name == "session")


def broken_rule(facts: Facts, allowed: Allowed, match: Match | None) -> GuardRule | None:
    """The first rule that a request breaks; None: it may pass."""
    return next((rule for rule in RULES if not rule.holds(facts, allowed, match)), None)


def wants_json(headers: Mapping[str, str]) -> bool:
    """Whether a script asks, which cannot show a page."""
    return headers.get("accept", "").split(",")[0].strip() in {
        "application/json", "text/event-stream",
    }  # fmt: skip


class Guard:
    """The application behind it gets only requests that broke no rule.

    Args:
        app: the pages.
        context: of the console.
        pages: the table of pages.
        refuse: makes the answer of a refusal.
    """

    def __init__(
        self,
        app: ASGIApp,
        context: ConsoleContext,
        pages: Iterable[Page],
        refuse: Callable[[Request, HintedError], Response],
    ) -> None:
        self._app, self._context, self._refuse = app, context, refuse
        self._table = PageTable(pages)
        settings = context.settings
        self._allowed = Allowed(settings.hosts, settings.origins)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer one request (ASGI)."""
        if scope["type"] != "http":
            raise HttpRefused("only HTTP is served here")
        answer = _Answer(send, scope["path"], hsts=self._context.settings.hsts)
        scope["state"] = {"session": None}
        try:
            await self._pass(scope, receive, answer.send)
        except (HintedError, TimeoutError, ConnectionError) as error:
            if not answer.has_begun and not isinstance(error, ConnectionError):
                await self._end(scope, receive, answer.send, _as_refusal(error))
        except Exception as error:
            _log.error("a page crashed: %s", type(error).__name__, exc_info=error)
            if answer.has_begun:
                raise  # the connection is closed
            problem = HttpRefused("something went wrong here", "it is in the log", status=500)
            await self._end(scope, receive, answer.send, problem)

    async def _pass(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Check a request, and give it to its page.

        Raises:
            HintedError: it breaks a rule.
            TimeoutError: its body comes too slowly, or its answer is taken too slowly.
            ConnectionError: it was broken off.
        """
        check_peer(scope, self._context.settings.users)
        request = Request(scope)
        session = self._session(request.headers)
        match = self._table.find(scope["path"], scope["method"])
        rule = broken_rule(facts_of(scope, has_session=session is not None), self._allowed, match)
        if rule is not None:
            await self._answer(rule, match, request)(scope, receive, send)
            return
        scope["state"]["session"] = session
        if session is not None and (place := scope.get(PLACE)) is not None:
            place.belongs_to(owner_of(session))
        limit = 0 if match is None or match.page is None else match.page.max_body
        body = await _read_body(receive, limit)
        if not await self._counts(session, match):
            await self._answer(_NOT_LOGGED_IN, match, request)(scope, receive, send)
            return
        await self._app(scope, _replay(body, receive), send)

    async def _counts(self, session: Session | None, match: Match | None) -> bool:
        """Whether the phone that began a session was not removed; if it was, the session ends.

        Raises:
            HintedError: the service does not say.
        """
        page = None if match is None else match.page
        if session is None or page is None or page.access is Access.PUBLIC or page.path == LOG_OUT:
            return True
        counts = await self._context.phones.counts(session)
        if not counts:
            self._context.sessions.end(session)
        return counts

    def _answer(self, rule: GuardRule, match: Match | None, request: Request) -> Response:
        """The answer to a request that breaks a rule."""
        response: Response
        if rule.status == SEE_OTHER and not wants_json(request.headers):
            response = RedirectResponse("/login", SEE_OTHER)
        else:
            status = 401 if rule.status == SEE_OTHER else rule.status
            response = self._refuse(request, HttpRefused(rule.message, rule.hint, status=status))
        if rule.name == "method" and match is not None:
            response.headers["Allow"] = ", ".join(sorted(match.methods))
        if has_body(request.headers):
            response.headers["Connection"] = "close"  # it is not read
        return response

    async def _end(self, scope: Scope, receive: Receive, send: Send, error: HintedError) -> None:
        response = self._refuse(Request(scope), error)
        response.headers["Connection"] = "close"
        await response(scope, receive, send)

    def _session(self, headers: Headers) -> Session | None:
        now = self._context.elapsed()
        found = self._context.sessions.find(_cookie(headers), now)
        if found is not None and is_by_person(headers):
            self._context.sessions.use(found, now)
        return found


def is_by_person(headers: Mapping[str, str]) -> bool:
    """Whether a person did this, so that a page which reloads itself keeps no session alive.

    Browsers say so of navigations (`Sec-Fetch-User`); older ones send none of these headers.
    """
    if "sec-fetch-mode" not in headers or headers.get("sec-fetch-user") == "?1":
        return True
    return headers.get("content-type") is not None  # a form or an approval


def has_body(headers: Mapping[str, str]) -> bool:
    """Whether a body comes after these headers (RFC 9112 section 6)."""
    return headers.get("content-length", "0") != "0" or "transfer-encoding" in headers


def _as_refusal(error: HintedError | TimeoutError) -> HintedError:
    if isinstance(error, TimeoutError):
        return HttpRefused("this took too long", "try it again", status=408)
    if isinstance(error, PeerUserRefused):
        return HttpRefused(str(error), error.hint, status=403)
    return error


def facts_of(scope: Scope, *, has_session: bool) -> Facts:
    """What a request says."""
    headers = Headers(scope=scope)
    return Facts(
        scope["method"],
        tuple(headers.getlist("host")),
        tuple(headers.getlist("origin")),
        headers.get("sec-fetch-site", ""),
        _length(headers.getlist("content-length")),
        has_session,
    )


def _length(found: list[str]) -> int | None:
    """The announced length; 0: none was, and reading counts."""
    if not found:
        return 0
    text = found[0]
    return int(text) if len(found) == 1 and text.isascii() and text.isdigit() else None


def _cookie(headers: Headers) -> str:
    """The value of the session's cookie; empty: there is none, or more than one."""
    pairs = [part.strip() for text in headers.getlist("cookie") for part in text.split(";")]
    found = [pair.partition("=")[2] for pair in pairs if pair.partition("=")[0] == COOKIE]
    return found[0] if len(found) == 1 else ""


async def _read_body(receive: Receive, limit: int) -> bytes:
    """The whole body.

    Raises:
        HttpRefused: it is larger than `limit`.
        TimeoutError, ConnectionResetError: it did not come.
    """
    body = bytearray()
    async with asyncio.timeout(BODY):
        while True:
            message = await receive()
            if message["type"] != "http.request":
                raise ConnectionResetError
            body += message.get("body", b"")
            if len(body) > limit:
                raise HttpRefused("this is too large", "send less", status=413)
            if not message.get("more_body", False):
                return bytes(body)


def _replay(body: bytes, receive: Receive) -> Receive:
    """A `receive` that gives the body once, and then what comes after it."""
    messages: list[Message] = [{"type": "http.request", "body": body, "more_body": False}]

    async def read() -> Message:
        return messages.pop() if messages else await receive()

    return read


class _Answer:
    """Sends an answer with the headers that every one has, to somebody who takes it."""

    def __init__(self, send: Send, path: str, *, hsts: bool) -> None:
        self._send, self._path, self._hsts = send, path, hsts
        self.has_begun = False

    async def send(self, message: Message) -> None:
        """Pass on a piece.

        Raises:
            TimeoutError: nobody takes it.
        """
        if message["type"] == "http.response.start":
            self.has_begun = True
            message = {**message, "headers": self._headers(message)}
        async with asyncio.timeout(WRITE):
            await self._send(message)

    def _headers(self, message: Message) -> list[tuple[bytes, bytes]]:
        immutable = self._path.startswith(PREFIX) and message["status"] == 200
        added = security_headers(immutable=immutable, hsts=self._hsts)
        names = {name for name, _ in added}
        kept = [pair for pair in message.get("headers", ()) if pair[0].lower() not in names]
        return [*kept, *added]

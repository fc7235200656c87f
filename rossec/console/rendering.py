"""What a page is, what its request says, and the HTML and static files that answer it.

Bodies are read strictly: one type, UTF-8, each field once; there are no files in forms, so no multipart.
"""

import base64
import binascii
import json
import mimetypes
import re
from collections.abc import Awaitable, Callable, Iterable
from contextvars import ContextVar
from enum import Enum
from functools import cache, partial
from hashlib import sha256
from pathlib import Path
from typing import Any, Final, NamedTuple, TypeAlias
from urllib.parse import parse_qsl, quote

from jinja2 import Environment, FileSystemLoader, StrictUndefined
from starlette.requests import Request
from starlette.responses import HTMLResponse, RedirectResponse, Response
from starlette.routing import compile_path

from ca.approvals.passkeys import base64url
from rossec.console.context import ConsoleContext
from rossec.console.sessions import LoginSession, owner_of
from rossec.console.words import NONE, Names, ago, day, topic
from rossec.errors import HttpRefused
from rossec.peer_limits import printable

Handler: TypeAlias = Callable[["Visit"], Awaitable[Response]]
MAX_BODY: Final = 16 * 1024
MAX_FRAME: Final = 256 * 1024  # a picture from a camera


class PageAccess(Enum):
    PUBLIC = "public"
    SESSION = "session"


PUBLIC: Final = PageAccess.PUBLIC
SESSION: Final = PageAccess.SESSION


class Page(NamedTuple):
    path: str  # as starlette writes it
    methods: tuple[str, ...]
    handler: Handler
    access: PageAccess = SESSION  # unless it says otherwise: none is public by mistake
    max_body: int = MAX_BODY
    looks: bool = False  # a console that only shows has it, too: logging in and out


class PageList(list[Page]):
    """The pages of a module: each is written above the function that answers."""

    def get(self, path: str, access: PageAccess = SESSION) -> Callable[[Handler], Handler]:
        return self.post(path, access, method="GET")

    def post(
        self, path: str, access: PageAccess = SESSION, method: str = "POST", **options: Any
    ) -> Callable[[Handler], Handler]:
        def add(handler: Handler) -> Handler:
            self.append(Page(path, (method,), handler, access, **options))
            return handler

        return add


def for_looking(pages: Iterable[Page]) -> tuple[Page, ...]:
    found = tuple(pages)
    acting = {page.path for page in found if "POST" in page.methods and not page.looks}
    return tuple(page for page in found if page.path not in acting)


class Match(NamedTuple):
    page: Page | None  # None: the method is wrong
    methods: frozenset[str]  # of the path


class PageTable:
    def __init__(self, pages: Iterable[Page]) -> None:
        self._pages = [(compile_path(page.path)[0], page) for page in pages]

    def find(self, path: str, method: str) -> Match | None:
        found = [page for pattern, page in self._pages if pattern.match(path)]
        if not found:
            return None
        wanted = "GET" if method == "HEAD" else method
        page = next((page for page in found if wanted in page.methods), None)
        methods = {method for page in found for method in page.methods}
        return Match(page, frozenset(methods | ({"HEAD"} if "GET" in methods else set())))


MAX_FIELDS: Final = 64
_FORM: Final = "application/x-www-form-urlencoded"
_JSON: Final = "application/json"
_HALVES: Final = re.compile("[\ud800-\udfff]")
_HINT: Final = "go back, load the page again, and try once more"


def text_field(fields: dict[str, Any], name: str, limit: int = 200) -> str:
    # JSON can escape half of a surrogate pair, which is no text (RFC 8259 section 8.2).
    value = fields.get(name, "")
    if not isinstance(value, str) or len(value) > limit or _HALVES.search(value):
        raise HttpRefused(f"{name}: not a text of at most {limit} characters", _HINT)
    return value


def bytes_field(fields: dict[str, Any], name: str) -> bytes:
    return from_base64url(text_field(fields, name, limit=16 * 1024))


def from_base64url(text: str) -> bytes:
    try:
        data = base64.b64decode(text + "=" * (-len(text) % 4), altchars=b"-_", validate=True)
    except (binascii.Error, ValueError) as error:
        raise HttpRefused("bytes that are not base64url", _HINT) from error
    if not data or base64url(data) != text:
        raise HttpRefused("bytes that are not base64url", _HINT)
    return data


def _once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    fields = dict(pairs)
    if len(fields) != len(pairs):
        raise HttpRefused("a field that comes twice", _HINT)
    return fields


PREFIX: Final = "/static/"
STATIC_FOLDER: Final = Path(__file__).parent / "static"
_TYPES: Final = {
    ".css": "text/css; charset=utf-8",
    ".js": "text/javascript; charset=utf-8",
    ".webmanifest": "application/manifest+json",
}
_DIGEST: Final = 16  # hex digits: an address, not a proof


ASSET_PAGES: Final = PageList()


class Asset(NamedTuple):
    path: str
    content: bytes
    type: str


@cache
def assets() -> dict[str, Asset]:
    return {path.name: _read(path) for path in sorted(STATIC_FOLDER.iterdir()) if path.is_file()}


def asset_path(name: str) -> str:
    return assets()[name].path


@ASSET_PAGES.get("/static/{digest}/{name}", PUBLIC)
async def show_asset(visit: "Visit") -> Response:
    # With another digest it does not exist: an address names one content, which browsers keep for ever.
    found = assets().get(visit.path["name"])
    if found is None or found.path != visit.request.url.path:
        raise HttpRefused("there is no such file", "load the page again", status=404)
    return Response(found.content, media_type=found.type)


def _read(path: Path) -> Asset:
    content = path.read_bytes()
    kind = _TYPES.get(path.suffix) or mimetypes.guess_type(path.name)[0]
    digest = sha256(content).hexdigest()[:_DIGEST]
    return Asset(f"{PREFIX}{digest}/{path.name}", content, kind or "application/octet-stream")


TEMPLATE_FOLDER: Final = Path(__file__).parent / "templates"
# Filters belong to the environment, which is made once; titles are those of one page.
_NAMES: ContextVar[Names] = ContextVar("names", default=NONE)


class PagePlace(NamedTuple):
    path: str
    label: str


NAVIGATION: Final = (
    PagePlace("/", "Today"),
    PagePlace("/who", "Who sees what"),
    PagePlace("/add", "Add a node"),
    PagePlace("/way", "Data flow"),
    PagePlace("/log", "What happened"),
    PagePlace("/phones", "Your phone"),
)


class Visit:
    """One request to a page: what it says, and the answers that a page has."""

    def __init__(self, request: Request, context: ConsoleContext) -> None:
        self.request, self.context = request, context
        self.service = context.service
        self.path, self.query = request.path_params, request.query_params

    @property
    def session(self) -> LoginSession:
        found: LoginSession = self.request.state.session
        return found

    @property
    def owner(self) -> str:
        return owner_of(self.session)

    @property
    def names(self) -> Names:
        found: Names = getattr(self.request.state, "names", NONE)
        return found

    @property
    def address(self) -> str:
        """The address of whoever asks; empty: not known (a proxy's socket)."""
        return self.request.client.host if self.request.client is not None else ""

    @property
    def id(self) -> bytes:
        return from_base64url(self.path["id"])

    async def form(self) -> dict[str, str]:
        """The fields of a form; a button alone has none."""
        body = await self.request.body()
        if not body:
            return {}
        self._require_type(_FORM)
        try:
            text = body.decode("ascii")
            strict = partial(parse_qsl, keep_blank_values=True, strict_parsing=True, errors="strict")
            pairs = strict(text, max_num_fields=MAX_FIELDS)
        except ValueError as error:  # UnicodeDecodeError is one
            raise HttpRefused("a form that is malformed", _HINT) from error
        return _once(pairs)

    async def json(self) -> dict[str, Any]:
        self._require_type(_JSON)
        try:
            value = json.loads((await self.request.body()).decode(), object_pairs_hook=_once)
        except (ValueError, RecursionError) as error:
            raise HttpRefused("JSON that is malformed", _HINT) from error
        if not isinstance(value, dict):
            raise HttpRefused("JSON that is no object", _HINT)
        return value

    def _require_type(self, wanted: str) -> None:
        # A form of another site can have `text/plain` without a preflight (CORS), and never JSON.
        if self.request.headers.get("content-type", "").partition(";")[0].strip().lower() != wanted:
            raise HttpRefused(f"a body that is not {wanted}", _HINT, status=415)

    def show(self, template: str, status: int = 200, /, **values: Any) -> Response:
        """The page that a template makes of `values`.

        Beside them it gets `domain`, `session` (None: nobody is logged in), `places` (the navigation),
        `here` (the path), `read_only`, `now`, and `number` (of the news). With `live=True` the page is
        loaded again when anything changes (`live.js`).
        """
        settings, state = self.context.settings, self.request.state
        session = getattr(state, "session", None)
        places = [place for place in NAVIGATION if not (settings.read_only and place.path == "/add")]
        values |= {"domain": settings.domain, "session": session, "places": places if session else ()}
        values |= {"here": self.request.url.path, "read_only": settings.read_only}
        values |= {"number": getattr(state, "number", ""), "now": self.context.clock()}
        return HTMLResponse(render_text(template, self.names, **values), status)


def go(path: str) -> Response:
    """See other: what a form has done is not done again when the page after it is loaded again."""
    return RedirectResponse(path, 303)


def render_text(template: str, names: Names = NONE, **values: Any) -> str:
    _NAMES.set(names)
    return environment().get_template(template).render(**values)


@cache
def environment() -> Environment:
    made = Environment(
        loader=FileSystemLoader(TEMPLATE_FOLDER),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    # Texts of nodes go through `printable` before they are escaped, so that none turns the direction of the
    # line or hides a character; `name` in `macros.html` puts them in `<bdi>` as well.
    made.globals["asset"] = asset_path
    made.filters |= {"printable": printable, "hex": bytes.hex, "base64url": base64url, "day": day}
    made.filters["title"] = _title
    made.filters["titled"] = lambda name: f"{_title(name)} {printable(name)}".strip()
    made.filters |= {"ago": ago, "address": quote, "topic": topic}  # of a name of ROS the slashes stay
    return made


def _title(name: str) -> str:
    return _NAMES.get().title(name)

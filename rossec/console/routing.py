"""What a page is, and how one is found by its path. Pure.

A page module has a table `PAGES`; `routes` puts them together. The guard answers what is not in
the table, so a page without an entry does not exist and one without a session is never public by
mistake: `SESSION` is what a page has unless it says otherwise.
"""

from collections.abc import Awaitable, Callable, Iterable
from enum import Enum
from typing import TYPE_CHECKING, Final, NamedTuple, TypeAlias

from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import compile_path

if TYPE_CHECKING:
    from rossec.console.context import ConsoleContext

Handler: TypeAlias = Callable[[Request, "ConsoleContext"], Awaitable[Response]]
MAX_BODY: Final = 16 * 1024
MAX_FRAME: Final = 256 * 1024  # a picture from a camera


class Access(Enum):
    """Who may ask for a page: anyone who reaches the console, or who has logged in."""

    PUBLIC = "public"
    SESSION = "session"


PUBLIC: Final = Access.PUBLIC
SESSION: Final = Access.SESSION


class Page(NamedTuple):
    """A path (as starlette writes it), the methods it has, and what answers them.

    `looks` marks what a console that only shows has beside pages to read: logging in and out.
    """

    path: str
    methods: tuple[str, ...]
    handler: Handler
    access: Access = SESSION
    max_body: int = MAX_BODY
    looks: bool = False


def for_looking(pages: Iterable[Page]) -> tuple[Page, ...]:
    """The pages of a console that only shows: no form that does something, and no page of one."""
    found = tuple(pages)
    acting = {page.path for page in found if "POST" in page.methods and not page.looks}
    return tuple(page for page in found if page.path not in acting)


class Match(NamedTuple):
    """The page of a path and method (None: the method is wrong), and the methods of the path."""

    page: Page | None
    methods: frozenset[str]


class PageTable:
    """Finds pages by path and method, the first that fits."""

    def __init__(self, pages: Iterable[Page]) -> None:
        self._pages = [(compile_path(page.path)[0], page) for page in pages]

    def find(self, path: str, method: str) -> Match | None:
        """The pages at `path`; None: there are none. Where there is a GET there is a HEAD."""
        found = [page for pattern, page in self._pages if pattern.match(path)]
        if not found:
            return None
        wanted = "GET" if method == "HEAD" else method
        page = next((page for page in found if wanted in page.methods), None)
        methods = {method for page in found for method in page.methods}
        return Match(page, frozenset(methods | ({"HEAD"} if "GET" in methods else set())))

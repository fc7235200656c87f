"""Templates: what a page shows becomes HTML, with everything escaped.

Texts of nodes go through `printable` before they are escaped, so that none turns the direction of
the line or hides a character; `name` in `macros.html` puts them in `<bdi>` as well.
"""

from contextvars import ContextVar
from functools import cache
from pathlib import Path
from typing import Any, Final, NamedTuple
from urllib.parse import quote

from jinja2 import Environment, FileSystemLoader, StrictUndefined
from starlette.requests import Request
from starlette.responses import HTMLResponse, Response

from rossec.console.assets import asset_path
from rossec.console.context import ConsoleContext
from rossec.console.forms import to_base64url
from rossec.console.names import NONE, Names
from rossec.console.words import ago, day, topic
from rossec.ros.text import printable

FOLDER: Final = Path(__file__).parent / "templates"
# Filters belong to the environment, which is made once; titles are those of one page.
_NAMES: ContextVar[Names] = ContextVar("names", default=NONE)


class Place(NamedTuple):
    """An entry of the navigation."""

    path: str
    label: str


NAVIGATION: Final = (
    Place("/", "Today"),
    Place("/who", "Who sees what"),
    Place("/add", "Add a node"),
    Place("/way", "Data flow"),
    Place("/log", "What happened"),
    Place("/phones", "Your phone"),
)


def render(
    context: ConsoleContext, request: Request, template: str, status: int = 200, **values: Any
) -> Response:
    """The page that a template makes of `values`.

    Beside them it gets `domain`, `session` (None: nobody is logged in), `places` (the navigation),
    `here` (the path), `read_only`, `now`, and `number` (of the news). With `live=True` the page is
    loaded again when anything changes (`live.js`).
    """
    session = getattr(request.state, "session", None)
    _NAMES.set(names_of(request))
    text = environment().get_template(template).render(
        domain=context.settings.domain,
        session=session,
        places=_places(context) if session is not None else (),
        here=request.url.path,
        read_only=context.settings.read_only,
        number=getattr(request.state, "number", ""),
        now=context.clock(),
        **values,
    )  # fmt: skip
    return HTMLResponse(text, status)


def _places(context: ConsoleContext) -> tuple[Place, ...]:
    """The navigation; a console that only shows adds no node."""
    only_shows = context.settings.read_only
    return tuple(place for place in NAVIGATION if not (only_shows and place.path == "/add"))


def names_of(request: Request) -> Names:
    """What the policy calls things, as it was asked for this page."""
    found: Names = getattr(request.state, "names", NONE)
    return found


def render_text(template: str, names: Names = NONE, **values: Any) -> str:
    """What a template makes of `values` alone: for a file instead of a page."""
    _NAMES.set(names)
    return environment().get_template(template).render(**values)


@cache
def environment() -> Environment:
    """The templates, with what they can use; made once."""
    made = Environment(
        loader=FileSystemLoader(FOLDER), autoescape=True, undefined=StrictUndefined,
        trim_blocks=True, lstrip_blocks=True,
    )  # fmt: skip
    made.globals["asset"] = asset_path
    made.filters["printable"] = printable
    made.filters["hex"] = bytes.hex
    made.filters["base64url"] = to_base64url
    made.filters["day"] = day
    made.filters["title"] = _title
    made.filters["titled"] = _titled
    made.filters["ago"] = ago
    made.filters["address"] = quote  # of a name of ROS: its slashes stay
    made.filters["topic"] = topic
    return made


def _title(name: str) -> str:
    return _NAMES.get().title(name)


def _titled(name: str) -> str:
    """The name with its title before it, where there is no room for two elements."""
    return f"{_title(name)} {printable(name)}".strip()

"""The static files: read once, served under the digest of their content, so none is ever stale.

`/static/DIGEST/NAME` with another digest does not exist: an address names one content for ever.
"""

import mimetypes
from functools import cache
from hashlib import sha256
from pathlib import Path
from typing import Final, NamedTuple

from starlette.requests import Request
from starlette.responses import Response

from rossec.console.context import ConsoleContext
from rossec.console.routing import PUBLIC, Page
from rossec.errors import HttpRefused

PREFIX: Final = "/static/"
FOLDER: Final = Path(__file__).parent / "static"
_TYPES: Final = {
    ".css": "text/css; charset=utf-8",
    ".js": "text/javascript; charset=utf-8",
    ".webmanifest": "application/manifest+json",
}
_DIGEST: Final = 16  # hex digits: an address, not a proof


class Asset(NamedTuple):
    """A static file."""

    path: str
    content: bytes
    type: str


@cache
def assets() -> dict[str, Asset]:
    """Every static file by its name."""
    return {path.name: _read(path) for path in sorted(FOLDER.iterdir()) if path.is_file()}


def asset_path(name: str) -> str:
    """The address of a static file."""
    return assets()[name].path


async def show(request: Request, _context: ConsoleContext) -> Response:
    """Answer with the file.

    Raises:
        HttpRefused: there is none of this name and digest.
    """
    found = assets().get(request.path_params["name"])
    if found is None or found.path != request.url.path:
        raise HttpRefused("there is no such file", "load the page again", status=404)
    return Response(found.content, media_type=found.type)


def _read(path: Path) -> Asset:
    content = path.read_bytes()
    kind = _TYPES.get(path.suffix) or mimetypes.guess_type(path.name)[0]
    digest = sha256(content).hexdigest()[:_DIGEST]
    return Asset(f"{PREFIX}{digest}/{path.name}", content, kind or "application/octet-stream")


PAGES: Final = (Page("/static/{digest}/{name}", ("GET",), show, PUBLIC),)

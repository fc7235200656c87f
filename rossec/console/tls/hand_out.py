"""The page that hands the TLS authority's certificate to a phone: plain HTTP, for ten minutes.

Plain, because the phone trusts nothing here yet: whoever is on the network can change the page. So
it does not show the fingerprint (an attacker's page would show the attacker's): it tells the reader
to compare what the phone shows with what the terminal shows. It knows no state, reads no header and
no body, and answers GET of two paths.
"""

import html
from base64 import b64encode
from collections.abc import Callable
from hashlib import sha256
from http import HTTPStatus
from importlib import resources
from string import Template
from typing import Final, NamedTuple

from starlette.types import ASGIApp, Receive, Scope, Send

from rossec.errors import ConfigurationError

SECONDS: Final = 600
PAGE: Final = "/"
FILE: Final = "/rossec-console.crt"
_OTHERS: Final = (
    (b"x-content-type-options", b"nosniff"),
    (b"referrer-policy", b"no-referrer"),
    (b"cache-control", b"no-store"),
)


class Document(NamedTuple):
    """What one path answers."""

    media_type: str
    body: bytes
    policy: str  # Content-Security-Policy


def documents(certificate: bytes, origin: str) -> dict[str, Document]:
    """What is handed out: the page at `PAGE`, the certificate (DER) at `FILE`. Pure.

    `origin` is the console's, where the reader goes afterwards.
    """
    style, text = (_text(name) for name in ("hand_out.css", "hand_out.html"))
    values = {"origin": html.escape(origin), "file": FILE, "style": style}
    digest = b64encode(sha256(style.encode()).digest()).decode()
    policy = f"default-src 'none'; style-src 'sha256-{digest}'; base-uri 'none'; form-action 'none'"
    page = Template(text).substitute(values).encode()
    return {
        PAGE: Document("text/html; charset=utf-8", page, f"{policy}; frame-ancestors 'none'"),
        FILE: Document("application/x-x509-ca-cert", certificate, "default-src 'none'"),
    }


def create_hand_out(certificate: bytes, origin: str, is_over: Callable[[], bool]) -> ASGIApp:
    """The application; it answers nothing but 410 once `is_over`."""
    found = documents(certificate, origin)

    async def answer(scope: Scope, _receive: Receive, send: Send) -> None:
        if scope["type"] != "http":
            raise ConfigurationError("only HTTP is served here")
        document = found.get(scope["path"])
        status = _status(scope["method"], document, over=is_over())
        if status is not HTTPStatus.OK or document is None:
            document = Document("text/plain", status.phrase.encode(), "default-src 'none'")
        await send({"type": "http.response.start", "status": status, "headers": _headers(document)})
        await send({"type": "http.response.body", "body": document.body})

    return answer


def _status(method: str, document: Document | None, *, over: bool) -> HTTPStatus:
    if over:
        return HTTPStatus.GONE
    if document is None:
        return HTTPStatus.NOT_FOUND
    return HTTPStatus.OK if method == "GET" else HTTPStatus.METHOD_NOT_ALLOWED


def _headers(document: Document) -> list[tuple[bytes, bytes]]:
    return [
        (b"content-type", document.media_type.encode()),
        (b"content-length", str(len(document.body)).encode()),
        (b"content-security-policy", document.policy.encode()),
        *_OTHERS,
    ]


def _text(name: str) -> str:
    return (resources.files(__package__) / name).read_text("utf-8")

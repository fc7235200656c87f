"""The headers of every response, also of errors. Pure.

No script makes HTML, so `trusted-types 'none'` holds; pictures are SVG with classes, so styles come
from the one file. `Referrer-Policy: no-referrer` would make browsers send `Origin: null` with the
console's own forms, which the guard refuses.
"""

from collections.abc import Mapping
from typing import Final

_POLICY: Final = "; ".join((
    "default-src 'none'",
    "script-src 'self'",
    "style-src 'self'",
    "img-src 'self' data: blob:",
    "connect-src 'self'",
    "media-src 'self' blob:",
    "manifest-src 'self'",
    "form-action 'self'",
    "base-uri 'none'",
    "frame-ancestors 'none'",
    "require-trusted-types-for 'script'",
    "trusted-types 'none'",
))  # fmt: skip
HEADERS: Final[Mapping[str, str]] = {
    "Content-Security-Policy": _POLICY,
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "same-origin",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Permissions-Policy": (
        "camera=(self), publickey-credentials-get=(self), microphone=(), geolocation=()"
    ),
    "Cache-Control": "no-store",
}
IMMUTABLE: Final = "public, max-age=31536000, immutable"
HSTS: Final = "max-age=31536000"


def security_headers(*, immutable: bool = False, hsts: bool = False) -> list[tuple[bytes, bytes]]:
    """The headers of a response as ASGI writes them.

    Args:
        immutable: it is a static file, whose address changes with its content.
        hsts: browsers shall insist on https for this name.
    """
    headers = dict(HEADERS)
    if immutable:
        headers["Cache-Control"] = IMMUTABLE
    if hsts:
        headers["Strict-Transport-Security"] = HSTS
    return [(name.lower().encode(), text.encode()) for name, text in headers.items()]
